"""A USD file under construction: its prims from the first frame on, and what moves from frame to frame."""

from math import radians, tan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.outputs.parts import Parts, Texture, Textures, few_colours, in_3d, placed, single
from taichi_sim.outputs.rods import ROD, from_z, rod
from taichi_sim.outputs.wall_squares import wall_squares
from taichi_sim.render.camera import Camera, robust_bounds
from taichi_sim.render.palette import to_linear

APERTURE = 24.0  # mm, height of the camera's film: only its ratio to the focal length means something
APERTURE_UNIT = 0.1  # m of the scene for each unit of the aperture of an orthographic camera
ROUND_BALL = 3  # how often the triangles of a ball are cut in four
MARGIN = 1.1  # of a flat scene in its camera
MATERIALS = "/World/materials"
UNSAVED = 1 << 26  # bytes that wait in memory


class Stage:
    """A USD file under construction, of the scene that a frame is the first of."""

    def __init__(self, path: Path, first: Frame | None, fps: float, aspect: float, textures: Textures) -> None:
        from pxr import Usd, UsdGeom

        self._stage = Usd.Stage.CreateNew(str(path))
        self._binary, self._unsaved = path.suffix == ".usdc", 0
        UsdGeom.SetStageUpAxis(self._stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(self._stage, 1.0)
        self._stage.SetTimeCodesPerSecond(fps)
        self._stage.SetFramesPerSecond(fps)
        world = UsdGeom.Xform.Define(self._stage, "/World").GetPrim()
        self._stage.SetDefaultPrim(world)
        Usd.ModelAPI(world).SetKind("assembly")
        UsdGeom.Scope.Define(self._stage, MATERIALS)
        self._aspect, self._textures = aspect, textures
        self._last: dict[str, NDArray] = {}  # what each attribute holds that seldom changes
        self._fov: float | None = None  # of the camera in the last frame [degrees]
        if first is not None:
            self._parts = Parts(first, textures)
            self._build(first)

    def _build(self, first: Frame) -> None:
        from pxr import Usd, UsdGeom

        parts, self._objects = self._parts, list[str]()
        loose = parts.number[parts.loose]
        pairs, owner = parts.springs(first)
        self._single = parts.held() < 2
        for name in parts.names:
            prim = self._define(UsdGeom.Xform, "/World", name).GetPrim()
            Usd.ModelAPI(prim).SetKind("component")
            self._objects.append(str(prim.GetPath()))
        self._meshes = [self._surface(one) for one in parts.surfaces]
        self._points = [
            (balls, self._balls(k, balls)) for k in range(len(parts.names)) if len(balls := parts.loose[loose == k])
        ]
        self._rods = [(k, self._springs(k, pairs[owner == k], first.radius)) for k in np.unique(owner).tolist()]
        self._bodies = [self._body(one) for one in parts.bodies]
        self._walls(first)
        self._camera = self._define(UsdGeom.Camera, "/World", "camera")
        self._camera_place = self._camera.AddTransformOp()
        if first.dim == 2:
            self._look_at_plane(robust_bounds(in_3d(first.position), first.radius)[0])

    def _define(self, kind: Any, parent: str, name: str) -> Any:
        """A prim with this name, or one like it where that is no identifier or taken, and then the name to be shown."""
        from pxr import Tf

        valid = word = Tf.MakeValidIdentifier(name)
        number = 1
        while self._stage.GetPrimAtPath(f"{parent}/{word}"):
            word, number = f"{valid}_{number}", number + 1
        made = kind.Define(self._stage, f"{parent}/{word}")
        if word != name:
            made.GetPrim().SetDisplayName(name)
        return made

    def _part(self, kind: Any, number: int, part: str) -> Any:
        """A part of an object. Programs that merge it with its Xform show its name, which is therefore that of the object."""
        name = self._parts.names[number]
        return self._define(kind, self._objects[number], name if self._single[number] else f"{name}_{part}")

    def _surface(self, one: Any) -> Any:
        from pxr import Sdf, UsdGeom, Vt

        mesh = self._part(UsdGeom.Mesh, one.object, "surface")
        self._as_mesh(mesh, one.colour, self._textures.get(one.name) if one.uv is not None else None)
        if one.uv is not None:
            place = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
                "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex
            )
            place.Set(Vt.Vec2fArray.FromNumpy(single(one.uv)))
        return mesh

    def _mesh(self, parent: str, name: str, colour: Any) -> Any:
        from pxr import UsdGeom

        mesh = self._define(UsdGeom.Mesh, parent, name)
        self._as_mesh(mesh, colour)
        return mesh

    def _as_mesh(self, mesh: Any, colour: Any, texture: Texture | None = None) -> None:
        from pxr import UsdGeom

        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateDoubleSidedAttr(True)
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        self._paint(mesh, colour, texture)

    def _balls(self, number: int, balls: NDArray) -> Any:
        """Spheres, one shape for each colour: Blender gives neither points nor curves a material."""
        from pxr import UsdGeom, Vt

        made = self._part(UsdGeom.PointInstancer, number, "balls")
        made.CreateIdsAttr(Vt.Int64Array.FromNumpy(balls.astype(np.int64)))
        made.CreateScalesAttr(_vectors(np.repeat(self._parts.radius[balls, None], 3, axis=1)))
        colours, kind = few_colours(self._parts.colour[balls])
        made.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(kind.astype(np.int32)))
        ball = icosphere(ROUND_BALL)
        for k, colour in enumerate(colours):
            name = f"{self._parts.names[number]}_ball_{k}"
            self._shape(made, name, colour, ball.vertices, ball.triangles, ball.vertices)
        return made

    def _springs(self, number: int, pairs: NDArray, radius: NDArray) -> tuple[Any, float]:
        """Rods, and their radius [m]."""
        from pxr import UsdGeom

        made = self._part(UsdGeom.PointInstancer, number, "springs")
        name = f"{self._parts.names[number]}_rod"
        self._shape(made, name, self._parts.colour[pairs[0, 0]], *rod())
        return made, ROD * float(radius[pairs].min())

    def _shape(
        self, instancer: Any, name: str, colour: Any, vertices: NDArray, triangles: NDArray, normals: NDArray
    ) -> None:
        """Add a shape to those that an instancer puts in its places."""
        mesh = self._mesh(str(instancer.GetPath()), name, colour)
        self._still(mesh, vertices, triangles, normals)
        instancer.CreatePrototypesRel().AddTarget(mesh.GetPath())

    def _still(self, mesh: Any, vertices: NDArray, triangles: NDArray, normals: NDArray) -> None:
        """Give a mesh points that do not move."""
        self._faces(mesh, triangles, None)
        mesh.CreatePointsAttr(_vectors(vertices))
        mesh.CreateNormalsAttr(_vectors(normals))
        mesh.CreateExtentAttr(_vectors(_box(vertices)))

    def _body(self, one: Any) -> Any:
        mesh = self._mesh("/World", one.name, one.colour)
        self._still(mesh, one.vertices, one.triangles, one.normals)
        return mesh.AddTransformOp()

    def _walls(self, first: Frame) -> None:
        from pxr import UsdGeom

        for square in wall_squares(first):
            wall = square.body
            mesh = self._mesh("/World", wall.name, wall.colour)
            self._still(mesh, wall.vertices, wall.triangles, wall.normals)
            if not square.is_floor:
                mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)

    def _paint(self, prim: Any, colour: Any, texture: Texture | None = None) -> None:
        """Show it in sRGB colours, one, or one for each vertex, by displayColor and by a material that reads it; or an image."""
        from pxr import Sdf, UsdGeom, UsdShade

        colour = single(to_linear(np.asarray(colour).reshape(-1, 3)))
        one = bool(np.all(colour == colour[:1]))
        shown = prim.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant if one else UsdGeom.Tokens.vertex)
        shown.Set(_vectors(colour[:1] if one else colour))
        material = self._define(UsdShade.Material, MATERIALS, prim.GetPrim().GetName())
        path = material.GetPrim().GetPath().pathString
        shader = UsdShade.Shader.Define(self._stage, f"{path}/shader")
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.6)
        diffuse = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
        if texture is not None:
            diffuse.ConnectToSource(self._image(path, *texture))
        elif one:
            diffuse.Set(tuple(colour[0].tolist()))
        else:
            reader = UsdShade.Shader.Define(self._stage, f"{path}/reader")
            reader.CreateIdAttr("UsdPrimvarReader_float3")
            reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
            diffuse.ConnectToSource(reader.CreateOutput("result", Sdf.ValueTypeNames.Float3))
        material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", Sdf.ValueTypeNames.Token))
        UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(material)

    def _image(self, path: str, texture: str, repeat: float) -> Any:
        """The colour of an image file at st, so often repeated, as an output of a material's network."""
        from pxr import Gf, Sdf, UsdShade

        place = UsdShade.Shader.Define(self._stage, f"{path}/place")
        place.CreateIdAttr("UsdPrimvarReader_float2")
        place.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        image = UsdShade.Shader.Define(self._stage, f"{path}/texture")
        image.CreateIdAttr("UsdUVTexture")
        image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(texture)
        for side in ("wrapS", "wrapT"):
            image.CreateInput(side, Sdf.ValueTypeNames.Token).Set("repeat")
        st = place.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        if repeat != 1.0:
            scaled = UsdShade.Shader.Define(self._stage, f"{path}/repeat")
            scaled.CreateIdAttr("UsdTransform2d")
            scaled.CreateInput("scale", Sdf.ValueTypeNames.Float2).Set(Gf.Vec2f(repeat, repeat))
            scaled.CreateInput("in", Sdf.ValueTypeNames.Float2).ConnectToSource(st)
            st = scaled.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        image.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(st)
        return image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)

    def add(self, index: int, frame: Frame, camera: Camera | None) -> None:
        """Add a frame, as seen by a camera; None: by the one that stands still, in 2D."""
        parts = self._parts
        x = in_3d(
            frame.position.astype(np.float32).astype(np.float64)
        )  # what is derived from places is of those written
        for one, mesh, faces in zip(parts.surfaces, self._meshes, parts.triangles(frame)):
            points = one.points(x)
            self._faces(mesh, faces, index)
            self._move(mesh, points, index)
            self._set(mesh.GetNormalsAttr() or mesh.CreateNormalsAttr(), _vectors(one.normals(points, faces)), index)
        for balls, prim in self._points:
            self._move(prim, x[balls], index, parts.radius[balls].max())
        pairs, owner = parts.springs(frame)
        for k, (rods, radius) in self._rods:
            self._span(rods, x[pairs[owner == k]], radius, index)
        for prim, (centre, rotation) in zip(self._bodies, placed(frame)):
            self._seldom(prim, _matrix(rotation.T, centre), index)
        if camera is not None:
            self._look(camera, index)
        if self._binary and self._unsaved > UNSAVED:
            self._stage.GetRootLayer().Save()
            self._unsaved = 0

    def _span(self, rods: Any, ends: NDArray, radius: float, index: int) -> None:
        """Let rods of a radius [m] reach from one end to the other, (m, 2, 3) [m]."""
        from pxr import Vt

        along = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(along, axis=1)
        self._seldom(rods.GetProtoIndicesAttr(), np.zeros(len(ends)), index)
        self._move(rods, ends.mean(axis=1), index, radius + 0.5 * float(length.max(initial=0.0)))
        self._set(
            rods.GetScalesAttr(), _vectors(np.stack([0 * length + radius, 0 * length + radius, length], axis=1)), index
        )
        turns = np.ascontiguousarray(from_z(along, length), dtype=np.float16)
        self._set(rods.GetOrientationsAttr(), Vt.QuathArray.FromNumpy(turns), index)

    def _faces(self, mesh: Any, faces: NDArray, index: int | None) -> None:
        self._seldom(mesh.GetFaceVertexCountsAttr(), np.full(len(faces), 3), index)
        self._seldom(mesh.GetFaceVertexIndicesAttr(), faces.ravel(), index)

    def _seldom(self, target: Any, value: NDArray, index: int | None) -> None:
        """Set what seldom changes: one value, and others from the frame before it changes on."""
        from pxr import Gf, Vt

        key = str(target.GetPath() if hasattr(target, "GetPath") else target.GetAttr().GetPath())
        last = self._last.get(key)
        if last is not None and np.array_equal(last, value):
            return
        self._last[key] = value
        made = Gf.Matrix4d(value) if value.ndim == 2 else Vt.IntArray.FromNumpy(value.astype(np.int32))
        if index is None or last is None:
            target.Set(made)
            return
        if not target.GetNumTimeSamples():
            target.Set(target.Get(), 0)
        if value.ndim == 2 and index - 1 not in target.GetTimeSamples()[-1:]:  # it stood still until now
            target.Set(Gf.Matrix4d(last), index - 1)
        target.Set(made, index)

    def _move(self, prim: Any, points: NDArray, index: int, reach: float = 0.0) -> None:
        """Put a prim's points somewhere, which reach so far about them [m]."""
        of = prim.GetPositionsAttr() if hasattr(prim, "GetPositionsAttr") else prim.GetPointsAttr()
        self._set(of, _vectors(points), index)
        if len(points):
            box = _box(points) + reach * np.array([[-1.0], [1.0]])
            self._set(prim.GetExtentAttr() or prim.CreateExtentAttr(), _vectors(box), index)

    def _set(self, attribute: Any, value: Any, index: int) -> None:
        attribute.Set(value, index)
        self._unsaved += 12 * len(value)

    def _look(self, camera: Camera, index: int) -> None:
        from pxr import Gf

        right, up, forward = camera.axes()
        self._seldom(self._camera_place, _matrix(np.stack([right, up, -forward]), np.array(camera.eye)), index)
        if self._fov != camera.fov:
            self._camera.GetFocalLengthAttr().Set(0.5 * APERTURE / tan(radians(0.5 * camera.fov)), index)
        if self._fov is None:
            self._camera.CreateVerticalApertureAttr(APERTURE)
            self._camera.CreateHorizontalApertureAttr(APERTURE * self._aspect)
            away = camera.distance
            self._camera.CreateClippingRangeAttr(Gf.Vec2f(0.01 * away, 100.0 * away))
            self._camera.CreateFocusDistanceAttr(away)
        self._fov = camera.fov

    def _look_at_plane(self, bounds: Any) -> None:
        from pxr import Gf, UsdGeom

        middle, (width, height, _) = 0.5 * (bounds.low + bounds.high), MARGIN * (bounds.high - bounds.low)
        height = max(height, width / self._aspect)
        self._camera.CreateProjectionAttr(UsdGeom.Tokens.orthographic)
        self._camera.CreateVerticalApertureAttr(height / APERTURE_UNIT)
        self._camera.CreateHorizontalApertureAttr(height * self._aspect / APERTURE_UNIT)
        self._camera.CreateClippingRangeAttr(Gf.Vec2f(0.01 * height, 100.0 * height))
        self._camera_place.Set(Gf.Matrix4d(_matrix(np.eye(3), middle + np.array([0.0, 0.0, 10.0 * height]))))

    def save(self, frames: int) -> None:
        """Complete the file."""
        self._stage.SetStartTimeCode(0)
        self._stage.SetEndTimeCode(max(0, frames - 1))
        self._stage.GetRootLayer().Save()


def _vectors(values: NDArray) -> Any:
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(single(values).reshape(-1, 3))


def _box(points: NDArray) -> NDArray:
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _matrix(rows: NDArray, place: NDArray) -> NDArray[np.float64]:
    """Matrix (4, 4) that moves row vectors, from the images of the axes, one to a row, and of the origin."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = rows, place
    return matrix
