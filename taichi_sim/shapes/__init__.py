"""Shapes: free functions that add balls, springs and triangles to a scene and return what they added.

    scene = ts.Scene(dim=3, gravity=(0, -9.81, 0))
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(32, 32), pinned=[0, 31 * 32], position=(0, 1, 0))

`position`, `rotation` and `scale` move the finished shape: scaled about its origin, turned, then shifted; scale changes no
given mass. A wrong argument is a SceneError that names it; the scene is then unchanged.

Args that several shapes have:
    mass: of the whole shape [kg]; shared out equally.
    damping: of each spring, along it [N s/m]; a tenth of the critical damping of its two balls by default.
    radius: of each ball [m].
    velocity: (dim,) of all of its balls that are not pinned [m/s]; none by default.
    pinned: true or false for all of its balls, a list of that for each, or their numbers within the shape. Or "border",
        "corners", "left", "right", "bottom", "top", in 3D "front", "back" (the side toward -x, +x, -y, +y, +z, -z once it is
        placed), of a rope "start", "end" or "ends". Or a box, sphere or capsule, as a collider is described, for all with their
        centre in it. Or a list of such.
    material: name of a material added before, or of a preset (`taichi-sim materials`): then what is not given of mass, stiffness
        and the like is the preset's, where it knows such a shape.
    position: (dim,) by how far the shape is shifted [m].
    rotation: about its own origin [degrees]: about the x, y and z axis in this order, in 2D one angle.
    scale: its size in relation to what the other arguments say [1].
    colour: sRGB in 0..1 [1]; chosen by the renderer otherwise.
    self_collision: whether its balls collide with each other; those that a spring, a solid or a brick joins never do.
    surface_collision: in 3D, whether nothing goes through its triangles, its own balls included. One is no more
        once a spring at its side has torn.

Defaults. A stiffness that is not given follows from the mass and the resolution so that the bound which holds for
every shape the springs can take, h^2 (S_i/m_i + S_j/m_j) < 4 for each spring (physics section 5), is met at h = 1 ms
with a factor 2 to spare, whatever the resolution: velocity Verlet is then stable at 1 ms. Finer shapes of the same
mass are therefore softer: held by one edge, a cloth of 1 m stretches by about 5 % at the top with 32 x 32 balls and
20 % with 64 x 64. For a firmer one give a stiffness and let `dt = "auto"` find the step. A rope is always of a
material unless a stiffness is given, and its step is shorter the finer it is: 0.3 ms for 32 balls on 1 m.

Materials. A cloth of `stretch_stiffness`, `mass_per_area` and the like, a jelly of `young_modulus` and `density`, and
a rope of `EA` and `EI` are the same thing at every resolution: they hang, bend and swing alike, and only their fine
wrinkles differ.
"""

from taichi_sim.shapes.balloon import balloon
from taichi_sim.shapes.base import Shape
from taichi_sim.shapes.cloth import cloth
from taichi_sim.shapes.jelly import jelly
from taichi_sim.shapes.letters import svg, text
from taichi_sim.shapes.piles import pile, tower
from taichi_sim.shapes.ropes import rope, wheel
from taichi_sim.shapes.trusses import net, truss

__all__ = [
    "BUILT_IN",
    "Shape",
    "balloon",
    "cloth",
    "jelly",
    "net",
    "pile",
    "rope",
    "svg",
    "text",
    "tower",
    "truss",
    "wheel",
]

# in the order in which a scene file's are added
BUILT_IN = (cloth, jelly, rope, wheel, pile, truss, net, balloon, tower, text, svg)
