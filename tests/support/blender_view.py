"""Blender's view of files: run by a Python that has bpy, this writes a JSON of each. python blender_view.py OUT.json FILE ...;
or, with --write FOLDER, files of a mesh as Blender exports it."""

import json
import sys
from pathlib import Path

import bpy
import numpy as np

IMPORTS = {
    ".usdc": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usda": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    ".ply": lambda path: bpy.ops.wm.ply_import(filepath=path),
    ".stl": lambda path: bpy.ops.wm.stl_import(filepath=path),
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
}
COLOUR = "FLOAT_COLOR", "BYTE_COLOR", "FLOAT_VECTOR"


def seen(path):
    """The scene and its objects after a file is imported into an empty one."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    IMPORTS[Path(path).suffix](str(path))
    scene = bpy.context.scene
    frames = range(scene.frame_start, scene.frame_end + 1)
    objects = {}
    for one in bpy.data.objects:
        objects[one.name] = {
            "type": one.type,
            "parent": one.parent and one.parent.name,
            "hidden": one.hide_render or one.instance_type != "NONE",
            "materials": [material(slot.material) for slot in one.material_slots if slot.material],
            "layers": [layer.name for layer in getattr(one.data, "uv_layers", ())],
            "at": {k: at(one, k) for k in sorted({frames[0], frames[len(frames) // 2], frames[-1]})},
        }
    return {
        "fps": scene.render.fps / scene.render.fps_base,
        "frames": [scene.frame_start, scene.frame_end],
        "objects": objects,
        "instances": {k: instances(k) for k in sorted({frames[0], frames[len(frames) // 2], frames[-1]})},
        "images": [Path(image.filepath).name for image in bpy.data.images],
        "found": [bool(image.has_data or image.size[0]) for image in bpy.data.images],
    }


def instances(frame):
    """Place, size, name and material of all that is shown as an instance of another object."""
    bpy.context.scene.frame_set(frame)
    return [
        {
            "of": found.parent.name,
            "place": list(found.matrix_world.translation),
            "scale": found.matrix_world.median_scale,
            "materials": [material(slot.material) for slot in found.object.material_slots if slot.material],
        }
        for found in bpy.context.evaluated_depsgraph_get().object_instances
        if found.is_instance
    ]


def material(one):
    """Base colour, or what gives it."""
    shader = next((node for node in one.node_tree.nodes if node.type == "BSDF_PRINCIPLED"), None)
    if shader is None:
        return {"name": one.name, "colour": None, "from": None}
    base = shader.inputs["Base Color"]
    source = base.links[0].from_node if base.is_linked else None
    return {"name": one.name, "colour": list(base.default_value)[:3], "from": source and source.bl_idname}


def at(one, frame):
    """Points of an object in Blender's world, their colours and places on textures, at a frame."""
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    made = one.evaluated_get(graph)
    data = made.data
    found = {"place": np.array(made.matrix_world).tolist()}
    if one.type == "CAMERA":
        return found | {"lens": data.lens, "sensor": [data.sensor_width, data.sensor_height]}
    if data is None or not hasattr(data, "attributes"):
        return found
    points = data.attributes.get("position")
    if points is None:
        return found
    x = np.zeros(3 * len(points.data))
    points.data.foreach_get("vector", x)
    matrix = np.array(made.matrix_world)
    found["points"] = (x.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]).tolist()
    found["faces"] = len(getattr(data, "polygons", ()))
    found["attributes"] = sorted(one.name for one in data.attributes if not one.name.startswith("."))
    for layer in getattr(data, "uv_layers", ()):
        uv = np.zeros(2 * len(layer.uv))
        layer.uv.foreach_get("vector", uv)
        found["uv"] = uv.reshape(-1, 2).tolist()
        found["corners"] = [loop.vertex_index for loop in data.loops]
    for layer in data.attributes:
        if layer.data_type in COLOUR[:2]:
            colours = np.zeros(4 * len(layer.data))
            layer.data.foreach_get("color", colours)
            found["colours"] = np.unique(colours.reshape(-1, 4)[:, :3].round(4), axis=0).tolist()
    radius = data.attributes.get("radius")
    if radius is not None:
        r = np.zeros(len(radius.data))
        radius.data.foreach_get("value", r)
        found["radius"] = r.tolist()
    return found


OUTLINE = [(0, 0), (3, 0), (3, 1), (2, 1), (2, 2), (1, 2), (1, 1), (0, 1)]  # m, of a prism 0.5 m high


def write(folder):
    """Files of a prism whose caps are polygons that are not convex, with z up in Blender, as it exports them by default."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    n = len(OUTLINE)
    mesh = bpy.data.meshes.new("prism")
    sides = [(k, (k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)]
    vertices = [(x, y, z) for z in (0.0, 0.5) for x, y in OUTLINE]
    mesh.from_pydata(vertices, [], [tuple(range(n))[::-1], tuple(range(n, 2 * n)), *sides])
    mesh.uv_layers.new(name="UVMap")
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("prism", mesh))
    bpy.ops.wm.obj_export(filepath=f"{folder}/x.obj")
    for name, as_text in (("x", False), ("text", True)):
        bpy.ops.wm.ply_export(filepath=f"{folder}/{name}.ply", ascii_format=as_text)
        bpy.ops.wm.stl_export(filepath=f"{folder}/{name}.stl", ascii_format=as_text)
    bpy.ops.export_scene.gltf(filepath=f"{folder}/x.glb")
    bpy.ops.export_scene.gltf(filepath=f"{folder}/x.gltf", export_format="GLTF_SEPARATE")


if __name__ == "__main__" and sys.argv[1] == "--write":
    write(sys.argv[2])
elif __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps({path: seen(Path(path).resolve()) for path in sys.argv[2:]}))
