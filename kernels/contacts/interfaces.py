"""What the kernels of contacts read of the objects handed to them, with shape and unit, beside kernels.interfaces.

n balls in `dim` dimensions. What a scene does not need does not exist: each attribute may be absent where no kernel that is
compiled asks for it. Members of one table lie side by side.
"""

from typing import Any, NamedTuple, Protocol

from taichi_sim.kernels.interfaces import Ball, Field, Law, Model, State


class Plan(Protocol):
    """What contacts a scene has, see taichi_sim.contacts.plan."""

    pairs: bool  # of balls
    neighbours: bool  # whether balls or sticks look for balls
    walls: bool  # or colliders
    sticks: bool  # that balls touch
    warm_starts: bool  # whether solves start from what contacts accumulated in the step before
    soft: bool  # whether pairs are damped springs
    impacts_in_turn: bool  # whether pairs that close fast bounce one by one
    walls_in_turn: bool  # whether walls of balls among others do
    foresees: bool  # whether pairs that may meet within the step count
    loaded: bool  # whether what forces add is told from impacts
    line_search: bool  # see impact_iterations
    limits_energy: bool  # see energy_limiter
    reflects: bool  # whether impacts on walls throw back what forces did before them in the step
    gathers: bool  # whether both balls list a pair, and each sums what it gets
    by_colours: bool  # whether both list it, and pairs are solved in turn by colours
    atomic: bool  # whether impulses are added by atomics
    serial: bool  # whether one thread runs all


class Iteration(NamedTuple):
    """What an iteration over pairs does, fixed when it is compiled."""

    prepares: bool = (
        False  # finds masses, target speeds and bias velocities, with viscous friction: the first of a solve
    )
    impacts: bool = False  # of these, whether what closes fast is solved too, or left for the next solve
    stops_first: bool = False  # where the energy limiter compares both, what touches is stopped before it bounces
    yields_to_loads_only: bool = False  # soft contacts let go of a part of their load, not of what an impact gave them
    takes_back: bool = False  # the speed with which the solve before the move pushed out overlap
    starts: bool = True  # this solve began with what contacts accumulated before; else that was applied before the move


class Accumulated(Protocol):
    """What a contact accumulates."""

    impulse: float  # N s, along the normal
    tangential_impulse: Any  # N s, along the surface: a vector; of pairs in 2D along the normal turned by 90 degrees


class Iterated(Protocol):
    """What line searches ask of a contact."""

    previous_impulse: float  # N s, the normal impulse before the last iteration


class PairLink(Accumulated, Protocol):
    """What a pair keeps from step to step."""

    other: int  # the ball that is not the one whose list this is
    bias_velocity: float  # m/s, with which a soft contact pushes out overlap, or RIGID
    rebound_speed: float  # m/s, where restitution is part of the solve; 0 if it did not bounce
    colour: int  # of a pair that the ball solves whose list this is, or SOLVED_BY_OTHER, see pair_colours
    twin: int  # the link in which the other ball lists it, or NO_LINK


class PairContact(Iterated, Protocol):
    """What only one step needs of a pair. While lists are made anew, it holds the link of old."""

    normal: Field  # vector, from the ball that lists it to the other one
    depth: float  # m, overlap; negative where they are apart
    mass: float  # kg, of a lone contact 1 / (1 / m_i + 1 / m_j)
    target: float  # m/s, normal speed to come to
    rebound_speed: float  # m/s, that of the link of old
    starting_impulse: float  # N s, before the solve, where impacts are resolved in turn
    lister: int  # the ball that lists it
    next_from_others: int  # the next contact with the same other ball, or NO_CONTACT
    arm: float  # of each radius: balls that overlap touch nearer to their centres


class GridCopy(Protocol):
    """A ball as it was when the grid was made."""

    x: Field  # vector, m
    radius: float  # m


class GridWork(Protocol):
    """How much each loop of a search has to do: all, or nothing."""

    balls: int  # to be sorted
    buckets: int  # of all tables
    parts: int  # of balls whose box one thread measures
    ranked: int  # balls to be ordered by slabs
    slabs: int  # in which they are


class Grid(Protocol):
    """The cell-sorted hash of all balls, see spatial_hash. Levels: of balls by size, the finest first."""

    model: Model  # of the scene
    n: int  # balls
    dim: int  # 2 or 3
    skin: float  # of a radius: what may move without a new search
    enlarged: float  # times: radii with which pairs are looked for
    margin: float  # times: for rounded coordinates
    levels: int  # number of levels
    bound: Field  # (levels) m, largest radius
    inverse_width: Field  # (levels) 1/m, of cells across x
    size: int  # buckets of all levels
    chunk: int  # buckets that one thread sums
    table_size: Field  # (levels) buckets
    table_first: Field  # (levels) the first bucket
    count: Field  # (size) balls in a bucket, while it is made
    start: Field  # (size + 1) where the sorted copies of a bucket begin
    partial: Field  # (size / chunk) sums of chunk buckets
    second_partial: Field  # (second_parts) sums of these
    second_parts: int  # of SUMMED_BUCKETS^2 buckets
    bucket: Field  # (n) of each ball
    sorted: Field  # (n) the ball of each sorted copy
    copy_of: Field  # (n) the sorted copy of each ball, where searches are parallel
    order: Field  # (n) balls in the order of iterations
    copy: "GridCopy"  # (n) sorted
    colours: int  # of pairs, see pair_colours
    block: Field  # (colours n) the first sorted copy in each block of a colour
    block_count: Field  # (colours) number of them
    origin: Field  # (n) vector, m: where each ball was at the last search
    stale: Field  # (1) 1: the last search does not hold any more
    searches: Field  # (1) number
    work: "GridWork"  # (1) of the present search
    crowded_pairs: Field  # (1) pairs in crowded cells in the last search
    most_crowded_pairs: Field  # (1) the same in any that was given up
    pair_limit: Field  # (1) crowded pairs for which there is memory
    parts: int  # of part_size() balls
    low: Field  # (parts levels) cells: the lowest of a part
    high: Field  # (parts levels) the highest
    corner: Field  # (levels dim) the lowest cell in which a search may look
    top: Field  # (levels dim) the highest
    pitch: Field  # (levels dim) of rows where they lie side by side
    dense: Field  # (levels) 1: they do
    slabs: int  # most of them
    slab: Field  # (slabs + 1) where the balls of a slab begin
    rank: Field  # (n) place of a ball in the order by slabs
    extent: Field  # (dim) cells of the box around all balls
    slab_axis: Field  # (1) across which slabs lie
    slab_shift: Field  # (1) bits: cells of a slab


class Pairs(Protocol):
    """Contacts of two balls: each ball lists later ones near it, those that touch first."""

    model: Model  # of the scene
    grid: "Grid"  # in which they are found
    plan: "Plan"  # of the scene
    interleaved: bool  # whether the lists of all balls lie side by side, see pair_lists
    gap: float  # of the radii: how far apart balls count as touching
    link: "PairLink"  # (capacity) entries of all lists
    contact: "PairContact"  # (capacity) beside them
    capacity: int  # entries
    block_capacity: int  # entries for the lists of LIST_BLOCK balls
    pool_start: int  # the first entry for what does not fit there
    used: Field  # (1) entries of the pool
    overflow: Field  # (1) entries that would have been needed
    first: Field  # (n) first entry of the list of each ball; where the others lie: pair_lists.pair_entry
    number: Field  # (n) entries of the list
    touching: Field  # (n) of these, from the first on; with colours those that the ball solves
    held: Field  # (n) of these, from the first on, that may hold anything
    turn: Field  # (capacity) of those: place in the list of a ball, and colour, see pair_colours
    colours: Field  # (n) a bit for each colour of these
    old_first: Field  # (n) the same before the last search
    old_held: Field  # (n) the same
    first_from_others: Field  # (n) the first contact in which others list a ball, or NO_CONTACT
    longest_reach: Field  # (1) places in the order between balls of a pair, at most
    block_length: Field  # (1) places of a block, see pair_sweeps
    blocks: Field  # (1) number
    single_precision: bool  # of reals
    has_target: bool  # whether contacts have a target speed
    has_rebounds: bool  # whether they have a rebound speed
    only_law: int  # of all balls in the table of laws, or negative
    has_bodies: bool  # whether any balls are of one body that does not collide with itself
    body: Field  # (n) of each ball, 0: none
    has_springs: bool  # whether there are any: what they join does not collide
    spring_start: Field  # (n + 1) where the springs of a ball begin
    spring_other: Field  # (2 springs) the ball at the other end


class Incidences(Protocol):
    """Contacts of several balls, `capacity` of them at most. Entry e is the place of a ball in contact e // balls_per_contact."""

    model: Model  # of the scene
    pairs: "Pairs"  # of balls
    balls_per_contact: int  # places
    capacity: int  # contacts
    used: Field  # (1) contacts
    overflow: Field  # (1) contacts that would have been needed
    first: Field  # (n) of the list of each ball
    number: Field  # (n) entries in it
    entry: Field  # (balls_per_contact capacity) all lists
    entries: Field  # (1) in all lists

    def ball_of(self, entry: int) -> int:
        """The ball of an entry."""

    def comes_after(self, entry: int, other: int) -> bool:
        """An order of entries that does not depend on where threads put contacts."""


class StickContact(Accumulated, Iterated, Protocol):
    """A ball and a stick: weights 1 on the ball and -(1 - at), -at on the stick's ends."""

    ball: int  # that touches
    stick: int  # its number
    normal: Field  # vector, from stick to ball
    at: float  # part of the stick at which it touches
    distance: float  # m
    target: float  # m/s, normal speed to come to
    starting_impulse: float  # N s, before the solve
    gained_speed: float  # m/s, of approach since it was last seen
    last_speed: float  # m/s, normal speed with which it was last seen


class OldStickContact(Accumulated, Protocol):
    """The same under the last list."""

    other: int  # the ball


class Sticks(Incidences, Protocol):
    """Contacts of balls and sticks; those of a stick lie together."""

    grid: "Grid"  # in which they are found
    plan: "Plan"  # of the scene
    m: int  # sticks
    one: Field  # (m) ball at one end
    two: Field  # (m) ball at the other
    begin: Field  # (m) the first contact of a stick
    length: Field  # (m) their number
    contact: "StickContact"  # (capacity)
    old: "OldStickContact"  # (capacity) while they are listed anew
    applied_impulse: Field  # (capacity) vector, N s: still to be applied to the ball, and in parts to the ends

    def inverse_mass(self, solver: Any, contact: Any) -> float:
        """1/kg: sum w_i g_i^2 s_i of a contact."""

    def relative_velocity(self, ball: Any, contact: Any) -> Any:
        """m/s, of the ball from the stick where it touches."""

    def law(self, contact: Any) -> Law:
        """What the materials of both do to each other."""


class Triangle(Protocol):
    """A triangle, from its lowest ball on."""

    a: int  # ball at a corner
    b: int  # the same
    c: int  # the same
    beyond_a: int  # third ball of the triangle beyond the edge across from a, or BORDER or NOT_OWNED
    beyond_b: int  # the same across from b
    beyond_c: int  # the same across from c
    across_a: int  # where springs tear: the triangle of beyond_a, or that which owns the edge
    across_b: int  # the same across from b
    across_c: int  # the same across from c


class Severed(Protocol):
    """What has lost a side for good."""

    gone: Field  # one a row; 1: acts no more


class Edge(Protocol):
    """An edge of triangles, or a stick."""

    one: int  # ball at one end
    two: int  # ball at the other
    bare: int  # 1: a stick of no triangle


class Leaf(Protocol):
    """The box of what one ball owns."""

    low: Field  # vector, m: its corner
    high: Field  # vector, m: its opposite corner
    reach: float  # m, within which others concern it
    displacement: Field  # vector, m, of its ball in the step to come


class Node(Protocol):
    """A box of the tree."""

    low: Field  # vector, m: its corner
    high: Field  # vector, m: its opposite corner
    reach: float  # m, the largest of those in it
    lowest_displacement: Field  # vector, m, of any in it
    highest_displacement: Field  # vector, m, of any in it


class TriangleContact(Protocol):
    """A pair of a ball and a triangle, or of two edges."""

    owner: int  # the ball whose leaf listed it
    place: int  # among what that listed
    kind: int  # see kinds
    normal: Field  # vector, toward the upper side
    distance: float  # m
    thickness: float  # m, distance at touch; negative: may not be gone through, but does not push
    upper_plane: float  # m along the normal, from where its first ball began; see triangle_pairs.planes
    lower_plane: float  # m, the same


class TriangleCandidate(Protocol):
    """What may become a pair before the next search."""

    owner: int  # the ball whose leaf found it
    place: int  # among what that found
    first: int  # a ball, or an edge
    second: int  # a triangle, or -1 - f for edge f


class TriangleWork(Protocol):
    """Whether loops have anything to do: 1, or 0."""

    lists: int  # pairs are listed: the grid has not given up
    searches: int  # candidates are looked for: those of the last search hold no more
    expired: int  # they hold no more whatever has moved
    left_path: int  # some ball is not where it was expected
    left_path_later: int  # as what was found then cut its way short


class Triangles(Incidences, Protocol):
    """Contacts of triangles and edges that have thickness. Leaves are numbered by slots."""

    grid: "Grid"  # which knows where balls were
    triangle: "Triangle"  # all of them, by owner
    triangle_start: Field  # (n + 1) where those of a ball begin
    edge: "Edge"  # all of them, by owner
    edge_start: Field  # (n + 1) where those of a ball begin
    tears: bool  # whether springs can tear
    severed_triangles: "Severed"  # one a triangle, where they can
    severed_edges: "Severed"  # one an edge, likewise
    spacing: Field  # (n) m, distance that springs keep
    leaf: "Leaf"  # (leaf_count)
    leaf_count: int  # balls that own anything
    leaf_ball: Field  # (n) the ball of each slot; beyond leaf_count those that own nothing
    node: "Node"  # (2 bottom_nodes) node 1 is the whole tree
    bottom_nodes: int  # a power of two
    leaves_per_node: int  # at the bottom
    subtree_nodes: int  # at the bottom, above which one thread goes up
    stages: list  # for devices, a loop each: number of subtrees, which is their first node, and their height
    widest_skin: Field  # (1) m
    skin: Field  # (1) m, by which candidates may be further apart than pairs that are listed: that, or 0
    fastest: Field  # (1) m, longest way of a ball in this step beside the common one
    common_step: Field  # (1) vector, m: the common one
    candidate: "TriangleCandidate"  # (candidate_capacity)
    candidates: Field  # (1) number of them
    candidate_capacity: int  # candidates_per_contact capacity
    candidates_per_contact: int  # room for them
    searched_position: Field  # (n) vector, m: where balls were when candidates were looked for
    searched_displacement: Field  # (n) vector, m: the expected displacement of then
    common_way: Field  # (1) vector, m: that all have made in common since
    common_change: Field  # (1) vector, m: of the expected displacement
    expected_displacement: Field  # (n) vector, m: of a step, at the speeds with which pairs were found
    left_path: Field  # (n) 1: is not where that would have taken it
    allowed_part: Field  # (n) of its way that each ball may make
    work: "TriangleWork"  # (1) of the present loops
    contact: "TriangleContact"  # (capacity)
    member: Field  # (4 capacity) balls
    weight: Field  # (4 capacity) their weights


class ColliderPose(Protocol):
    """Where a collider is at the start of a step, and how it moves until its end."""

    x: Field  # vector, m, centre
    along: Field  # unit vector, the image of its local x axis
    across: Field  # unit vector, in 3D that of its local y axis
    v: Field  # vector, m/s
    spin: Any  # 1/s, angular velocity: a scalar in 2D, a vector in 3D


class ColliderShape(Protocol):
    """The shape of a collider."""

    kind: int  # see kinds
    half: Field  # vector, m: half of its size
    radius: float  # m, of what is round
    hollow: float  # m, thickness of its shell; 0: solid
    surface: int  # material
    extent: float  # m, radius of the sphere around it
    first: int  # number of the grid of a mesh
    low: Field  # vector, m: corner of that grid
    inverse_cell: float  # 1/m
    cells: Field  # (3) numbers along the axes
    first_node: int  # of the tree of a mesh
    last_node: int  # the node after its last


class Colliders(Protocol):
    """All colliders of a scene."""

    dim: int  # 2 or 3
    count: int  # number
    shape: "ColliderShape"  # (count)
    pose: "ColliderPose"  # (count)
    grid: Field  # m, distances from meshes, one grid behind the other
    exact: Field  # the same: number of the cell that begins there, of those where distances are taken from triangles, or -1
    cell: Field  # (2 such cells) a triangle near it, and its first leaf in `leaf`; no leaves where there are too many
    leaf: Field  # nodes of trees that are leaves and may hold the closest triangle
    box: Field  # m, (6 nodes) of the trees of meshes, see contacts.triangle_tree
    link: Field  # (3 nodes)
    triangle: Field  # (30 triangles)
    custom: list  # number of each that the user defines, and its Taichi function distance(p) [m], p in its own frame
    difference: float  # of an extent: between points whose distances give a direction
    faces: int  # of a hollow box, or 1
    has_round: bool  # whether any is a sphere, disc or capsule
    has_box: bool  # whether any is a box
    has_mesh: bool  # whether any is a mesh
    has_custom: bool  # whether any is of the user's own shape
    has_hollow: bool  # whether any is hollow
    has_faces: bool  # whether any is a hollow box
    moves: bool  # whether any moves
    rotates: bool  # whether any rotates

    def distance_from_origin(self, k: int) -> float:
        """m, of collider k: the larger, the coarser are places as seen from its centre."""

    def distance(self, k: int, face: int, x: Any, after: float) -> Any:
        """Distance [m], direction, and whether x is inside of a hollow one, `after` seconds into the step."""

    def collides_with(self, model: Any, i: int, k: int) -> bool:
        """Whether ball i collides with collider k."""


class Plane(Protocol):
    """A wall."""

    normal: Field  # unit vector, out of it


class Planes(Protocol):
    """All walls."""

    count: int  # number
    wall: "Plane"  # (count)

    def gap(self, x: Any, i: int, k: int) -> float:
        """m, from ball i at x to wall k, negative inside."""


class ColliderSlot(Protocol):
    """A contact of a ball with a collider, as it was found."""

    key: int  # the collider times `faces` plus the face of it, or EMPTY
    gap: float  # m, negative inside
    normal: Field  # unit vector, toward the ball
    velocity: Field  # vector, m/s, of the surface, along the chord of the step to come


class ColliderContacts(Protocol):
    """The colliders that each ball is at."""

    count: int  # slots of a ball
    slot: "ColliderSlot"  # (n count)
    filled: Field  # (n) number of slots in use
    moves: bool  # whether surfaces have velocities
    faces: int  # of a hollow box, or 1

    def collider(self, i: int, s: int) -> int:
        """The collider in slot s of ball i."""


class Received(Protocol):
    """Impulses that walls and colliders with probes have received."""

    plane: Field  # (walls) number among these, or -1
    solid: Field  # (colliders) the same

    def add(self, i: int, body: int, p: Any) -> None:
        """Ball i got p [N s] from a body."""

    def note(self, i: int) -> None:
        """What ball i gives from now on may be scaled."""

    def scale(self, i: int, less: float) -> None:
        """By 1 + less."""


class WallContact(Accumulated, Iterated, Protocol):
    """A ball and a surface of infinite mass."""

    target: float  # m/s, normal speed to come to
    role: int  # see kinds
    starting_impulse: float  # N s, before the solve


class Walls(Protocol):
    """Contact i count + k of ball i with surface k: walls, then slots for colliders."""

    model: Model  # of the scene
    state: State  # of the balls
    plan: "Plan"  # of the scene
    threshold: Field  # (1) m/s, approach speed below which nothing bounces
    planes: "Planes"  # walls
    collider_contacts: "ColliderContacts"  # slots
    colliders: "Colliders"  # of the scene
    has_colliders: bool  # whether there are any
    moves: bool  # whether any of these moves
    count: int  # surfaces of a ball
    contact: "WallContact"  # (n count)
    touching: Field  # (n) number of surfaces that a ball touches: most touch none and are passed over
    crowded: Field  # (n) see kinds
    clearance: Field  # (n) m to the nearest wall, where there are no colliders: most balls cannot reach any in a step
    reflected: Field  # vector (n) sqrt((1 + e) t / h) n of the last impact in this step, see impact
    rounding: float  # of a coordinate, as a part of it
    probed: bool  # whether probes ask for impulses
    received: "Received"  # these

    def tolerance(self, x: Any, i: int, far: float) -> float:
        """m, gap below which ball i at x touches what is `far` [m] from the origin."""

    def touch(self, x: Any, i: int, k: int) -> float:
        """m, the same for its surface k."""

    def reach_of(self, i: int, touch: float, crowded: bool) -> float:
        """m, gap up to which it is a contact."""

    def gap(self, x: Any, i: int, k: int) -> float:
        """m, from ball i at x to its surface k."""

    def normal(self, i: int, k: int) -> Any:
        """Direction from surface k to ball i."""

    def relative(self, v: Any, i: int, k: int) -> Any:
        """m/s, of ball i with the velocity v from surface k."""

    def law(self, i: int, k: int) -> Law:
        """What the materials of ball i and surface k do to each other."""

    def law_of_material(self, i: int, surface: int) -> Law:
        """The same with a material."""

    def is_solved(self, c: int) -> bool:
        """Whether contact c is a constraint of the solve."""

    def forget(self, c: int) -> None:
        """Contact c has accumulated nothing."""

    def record(self, i: int, k: int, p: Any) -> None:
        """Surface k gave ball i the impulse p [N s], for probes."""

    def gather(self, ball: Any, solver: Any, i: int, time: float) -> Any:
        """Further impulse and angular impulse on ball i from the surfaces on which it rests."""


class Swept(Protocol):
    """How much the search for impacts on the way has to do: all, or nothing."""

    moved_fast: int  # 1: something did
    balls: int  # to be looked at
    sticks: int  # the same
    shortened: int  # 1: a way was, in the last round


class EnergyTerms(Protocol):
    """Sums over a part of the balls [J], see energy_limiter; the last entry holds the whole."""

    lost: float  # by what has stopped
    linear: float  # of the changes since
    square: float  # of them


class Solver(Protocol):
    """A contact rule with all that it solves."""

    plan: "Plan"  # of the scene
    model: Model  # of the scene
    state: State  # of the balls
    n: int  # balls
    walls: "Walls"  # and colliders
    pairs: "Pairs"  # of balls
    sticks: "Sticks"  # that balls touch
    threshold: Field  # (1) m/s, approach speed below which nothing bounces
    rate: Field  # (1) 1/s, one over the substep
    in_turn: bool  # each pair sees what those before it changed
    split: bool  # each ball splits its mass between its contacts
    relaxation: float  # part of an impulse from split masses that is applied
    splits_by_direction: bool  # masses, not only by the number of contacts
    counts_pairs: bool  # whether `pair_count` is asked for
    pair_count: Field  # (n) pairs that touch a ball
    normal_tensor: Field  # (n) matrix, sum of n n^T over these
    effective_inverse_mass: Field  # (n) 1/kg, of the part of a ball that each contact gets
    velocity_before: Field  # (n) vector, m/s, before the solve
    spin_before: Field  # (n) m/s, the same
    warm_velocity: Field  # (n) vector, m/s, by the accumulated impulses of pairs with which a solve starts
    warm_spin: Field  # (n) m/s, the same
    impulse: Field  # (n) vector, N s, of all pairs in an iteration from old velocities
    angular_impulse: Field  # (n) N s, the same in units of a radius
    position_correction: Field  # (n) vector, m
    displacement: Field  # (n) vector, m, of the move just made
    time_of_impact: Field  # (n) part of the move that is made
    next_time_of_impact: Field  # (n) the same after this round
    longest_displacement: Field  # (1) m, of what moved fast
    crossing_squared: Field  # (1) m^2, what moves further may cross a stick
    swept: "Swept"  # (1)
    energy_type: Any  # of sums
    energy_parts: int  # of part_size() balls
    energy_scaling: Field  # (1) part of the changes that is taken back, negative
    energy: "EnergyTerms"  # (energy_parts, and behind these their groups)
    stopped_velocity: Field  # (n) vector, m/s, where all that touched has stopped
    stopped_spin: Field  # (n) m/s, the same
    velocity_when_found: Field  # (n) vector, m/s, when contacts were found
    velocity_from_forces: Field  # (n) vector, m/s, what forces added since
    block_limit: int  # the most blocks there may be
    block_is_active: Field  # (2 block_limit) 1: something closes fast in it, in this round and the next
    block_was_struck: Field  # (block_limit) 1: something bounced in it in this step
    disturbed: Field  # (n) the round after the last impact on a ball, or one in its list; 0: one closes fast; UNDISTURBED: none
    impacts: Field  # (n) on a ball in this step
    island: Field  # (n) a ball of the same island, in the end its root
    island_was_struck: Field  # (n) of a root
    last_iteration: Field  # (n) that took the contacts in the list of a ball, in this step; -1: none
    last_extension: Field  # (n) that counted its change
    island_iteration: Field  # (n) the last one of a root
    velocity_change: Field  # (n) vector, m/s, by the last iteration
    slope: Field  # (n) J, of a root, along that change
    curvature: Field  # (n) J, the same
    longest_extension: Field  # (n) times it may be made again

    def apply(self, i: int, p: Any, t: Any) -> None:
        """Impulse p [N s] on ball i, and angular impulse t in units of its radius."""


READS = {
    "solver": Solver,
    "pairs": Pairs,
    "grid": Grid,
    "sticks": Sticks,
    "triangles": Triangles,
    "walls": Walls,
    "colliders": Colliders,
    "shape": ColliderShape,
    "contacts": Incidences,
    "table": Accumulated,
    "iterated": Iterated,
    "how": Iteration,
    "ball": Ball,
}
