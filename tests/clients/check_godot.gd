# Poses a GLB file of write_assets that Godot's editor has imported, and compares with what write_assets says.
#
#   godot3 --path PROJECT -s check_godot.gd    (after godot3 --path PROJECT --editor --quit)
#
# PROJECT holds garment.glb and garment.json. Godot skins on the GPU; what its shader would get (bone poses,
# binds, bones and weights of the vertices) is multiplied here.
extends SceneTree

func nodes_of(node, type):
	var found = [node] if node.is_class(type) else []
	for child in node.get_children():
		found += nodes_of(child, type)
	return found

# Positions of one surface, as the shader has them.
func pose(instance, surface):
	var skeleton = instance.get_node(instance.skeleton)
	var maps = []
	for i in range(instance.skin.get_bind_count()):
		var bone = instance.skin.get_bind_bone(i)
		if bone < 0:
			bone = skeleton.find_bone(instance.skin.get_bind_name(i))
		maps.append(skeleton.get_bone_global_pose(bone) * instance.skin.get_bind_pose(i))
	var arrays = instance.mesh.surface_get_arrays(surface)
	var vertices = arrays[Mesh.ARRAY_VERTEX]
	var bones = arrays[Mesh.ARRAY_BONES]
	var weights = arrays[Mesh.ARRAY_WEIGHTS]
	var posed = []
	for v in range(vertices.size()):
		var sum = Vector3()
		var total = 0.0
		for k in range(4):
			sum += weights[4 * v + k] * maps[bones[4 * v + k]].xform(vertices[v])
			total += weights[4 * v + k]
		posed.append(skeleton.global_transform.xform(sum / total))
	return posed

func largest_difference(posed, wanted):
	if 3 * posed.size() != wanted.size():
		print(posed.size(), " vertices instead of ", wanted.size() / 3)
		return INF
	var largest = 0.0
	for v in range(posed.size()):
		var at = Vector3(wanted[3 * v], wanted[3 * v + 1], wanted[3 * v + 2])
		largest = max(largest, posed[v].distance_to(at))
	return largest

func check():
	var file = File.new()
	file.open("res://garment.json", File.READ)
	var expected = JSON.parse(file.get_as_text()).result
	var scene = load("res://garment.glb").instance()
	get_root().add_child(scene)
	yield(self, "idle_frame")
	var player = nodes_of(scene, "AnimationPlayer")[0]
	var surfaces = []
	for instance in nodes_of(scene, "MeshInstance"):
		for surface in range(instance.mesh.get_surface_count()):
			surfaces.append([instance, surface])
	var frames = expected["primitives"][0].size()
	var largest = 0.0 if surfaces.size() == expected["primitives"].size() else INF
	player.play(player.get_animation_list()[0])
	for frame in range(frames):
		player.seek(frame * expected["frame_time"], true)
		for i in range(surfaces.size()):
			var posed = pose(surfaces[i][0], surfaces[i][1])
			largest = max(largest, largest_difference(posed, expected["primitives"][i][frame]))
	print("difference ", largest, " in Godot ", Engine.get_version_info()["string"], ", ",
		surfaces.size(), " surfaces, ", frames, " frames")
	quit(0 if largest < 1e-4 else 1)

func _initialize():
	check()
