# Opens a GLB file of write_assets in Blender, poses it there, and compares with what write_assets says.
#
#   blender --background --python-exit-code 1 --python check_blender.py -- FILE.glb FILE.json
import json
import math
import sys

import numpy

numpy.bool = bool  # Debian's Blender 3.4 has a glTF importer for older numpy

import bpy

glb, expected = sys.argv[sys.argv.index('--') + 1:]
expected = json.load(open(expected))
bpy.ops.wm.read_factory_settings(use_empty=True)
# One frame of Blender per frame of the simulation; the importer begins at frame 0.
bpy.context.scene.render.fps = round(1.0 / expected['frame_time'])
bpy.ops.import_scene.gltf(filepath=glb, merge_vertices=False, guess_original_bind_pose=False)
scene = bpy.context.scene
meshes = {o.name: o for o in scene.objects if o.type == 'MESH'}
proxy = next(name for name in meshes if name.endswith('_proxy'))
garment = next(name for name in meshes if name == proxy[:-len('_proxy')])

frames = len(expected['primitives'][0])
worst = 0.0
for frame in range(frames):
    scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    for name, wanted in ((garment, expected['primitives'][0][frame] +
                          expected['primitives'][1][frame]),
                         (proxy, expected['primitives'][2][frame])):
        posed = meshes[name].evaluated_get(graph)
        points = [posed.matrix_world @ v.co for v in posed.data.vertices]
        # Blender is z-up: (x, y, z) of glTF is (x, -z, y).
        points = [(p.x, p.z, -p.y) for p in points]
        assert 3 * len(points) == len(wanted), (len(points), len(wanted) / 3)
        for v, p in enumerate(points):
            worst = max(worst, math.dist(p, wanted[3 * v:3 * v + 3]))
extras = meshes[proxy]['proxycloth']
print('difference', worst, 'in Blender', bpy.app.version_string)
assert worst < 1e-5
assert len(extras['triangles']) == 3 * len(meshes[proxy].data.polygons)
