// Opens the GLB files of write_assets in the programs that users have, poses them there, and
// compares with what write_assets says.
//
//   node check.mjs WRITE_ASSETS
//
// The clients are npm packages that are looked for in the folder PROXYCLOTH_CLIENTS:
//   cd FOLDER && npm install gltf-validator @babylonjs/core @babylonjs/loaders three
// Blender and Godot are looked for in PATH (Debian: apt install blender python3-numpy godot3 xvfb).
// Exit code: 0 all agree, 1 a difference, 77 no client is installed (skipped).
import { execFileSync, spawnSync } from 'node:child_process';
import { copyFileSync, existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync,
         writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { pathToFileURL } from 'node:url';

const clients = process.env.PROXYCLOTH_CLIENTS ?? '';
const installed = (name) => existsSync(join(clients, 'node_modules', name));
const load = (path) => import(pathToFileURL(resolve(clients, 'node_modules', path)).href);
const require = createRequire(resolve(clients, 'x.js'));

// Largest distance of two lists of coordinates.
function distance(a, b) {
  if (a.length !== b.length) return Infinity;
  let largest = 0;
  for (let i = 0; i < a.length; i += 3) {
    const d = Math.hypot(a[i] - b[i], a[i + 1] - b[i + 1], a[i + 2] - b[i + 2]);
    if (!(d <= largest)) largest = d;
  }
  return largest;
}

async function validator(glb) {
  const { validateBytes } = require('gltf-validator');
  const { issues } = await validateBytes(new Uint8Array(glb), { maxIssues: 20 });
  for (const issue of issues.messages.filter((m) => m.severity < 2)) console.log(issue);
  return { errors: issues.numErrors + issues.numWarnings, text: `infos ${issues.numInfos}` };
}

// Calls compare(primitive, frame, positions) for what a client shows.
async function babylon(glb, expected, compare) {
  const core = require('@babylonjs/core');
  require('@babylonjs/loaders/glTF');
  const engine = new core.NullEngine();
  const scene = new core.Scene(engine);
  scene.useRightHandedSystem = true;
  new core.FreeCamera('camera', core.Vector3.Zero(), scene);
  const result = await core.SceneLoader.ImportMeshAsync('', '', new Uint8Array(glb), scene, null,
                                                        '.glb');
  const meshes = result.meshes.filter((mesh) => mesh.getTotalVertices() > 0);
  const group = result.animationGroups[0];
  group.start(false);
  group.pause();
  for (let frame = 0; frame < expected.primitives[0].length; ++frame) {
    // 60 animation frames are a second.
    group.goToFrame(frame * expected.frame_time * 60);
    scene.render();
    meshes.forEach((mesh, primitive) => {
      mesh.skeleton.prepare(true);
      compare(primitive, frame, mesh.getPositionData(true));
    });
  }
  const proxy = meshes.find((mesh) => mesh.metadata?.gltf?.extras?.proxycloth);
  const bones = proxy.skeleton.bones.map((bone) => bone.name);
  const extras = { ...proxy.metadata.gltf.extras.proxycloth, bones };
  engine.dispose();
  return { count: meshes.length, extras };
}

async function three(glb, expected, compare) {
  globalThis.self = globalThis;
  const THREE = await load('three/build/three.module.js');
  const { GLTFLoader } = await load('three/examples/jsm/loaders/GLTFLoader.js');
  const buffer = glb.buffer.slice(glb.byteOffset, glb.byteOffset + glb.byteLength);
  const gltf = await new Promise((resolve, reject) =>
    new GLTFLoader().parse(buffer, '', resolve, reject));
  const meshes = [];
  gltf.scene.traverse((object) => object.isSkinnedMesh && meshes.push(object));
  const mixer = new THREE.AnimationMixer(gltf.scene);
  const action = mixer.clipAction(gltf.animations[0]);
  action.setLoop(THREE.LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  const point = new THREE.Vector3();
  for (let frame = 0; frame < expected.primitives[0].length; ++frame) {
    action.reset();
    mixer.setTime(frame * expected.frame_time);
    gltf.scene.updateMatrixWorld(true);
    meshes.forEach((mesh, primitive) => {
      mesh.skeleton.update();
      const positions = [];
      for (let v = 0; v < mesh.geometry.attributes.position.count; ++v) {
        mesh.getVertexPosition(v, point);
        point.applyMatrix4(mesh.matrixWorld);
        positions.push(point.x, point.y, point.z);
      }
      compare(primitive, frame, positions);
    });
  }
  const proxy = meshes.find((mesh) => mesh.userData.proxycloth);
  const bones = proxy.skeleton.bones.map((bone) => bone.name);
  return { count: meshes.length, extras: { ...proxy.userData.proxycloth, bones } };
}

// Whether a client hands on what a cloth solver needs: bones in the order of the proxy's vertices
// (Babylon has roots between them, a character has joints of its own), and springs as long as at rest.
// `rest`: the proxy's vertices in the file.
function checkExtras(extras, rest) {
  const { joints, bones, triangles, pinned, stretch_springs: stretch, bend_springs: bend } = extras;
  const point = (v) => rest.slice(3 * v, 3 * v + 3);
  const long = (springs) => springs.rest_lengths.every((length, i) => {
    const [a, b] = [point(springs.vertices[2 * i]), point(springs.vertices[2 * i + 1])];
    return Math.abs(length - Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2])) < 1e-6;
  });
  const known = new Set(joints);
  return String(joints) === String(bones.filter((bone) => known.has(bone))) && 3 * joints.length === rest.length &&
    triangles.length > 0 && triangles.length % 3 === 0 && Math.max(...triangles) < joints.length &&
    pinned.length > 0 && Math.max(...pinned) < joints.length &&
    stretch.rest_lengths.length > 0 && long(stretch) && stretch.stiffness > 0 &&
    bend.rest_lengths.length > 0 && long(bend) && bend.stiffness > 0 &&
    extras.simulation.time_step > 0;
}

// The JSON of a GLB file, and the positions of the last mesh, which is the proxy's.
function restPositions(glb) {
  const length = glb.readUInt32LE(12);
  const json = JSON.parse(glb.subarray(20, 20 + length));
  const accessor = json.accessors[json.meshes.at(-1).primitives[0].attributes.POSITION];
  const view = json.bufferViews[accessor.bufferView];
  const start = 28 + length + (view.byteOffset ?? 0) + (accessor.byteOffset ?? 0);
  return Array.from({ length: accessor.count }, (_, i) => [0, 4, 8].map((k) =>
    glb.readFloatLE(start + (view.byteStride ?? 12) * i + k))).flat();
}

// Godot's editor imports the files of a project; a script poses them.
function godot(folder, name) {
  const project = join(folder, `godot_${name}`);
  mkdirSync(project);
  copyFileSync(join(folder, `${name}.glb`), join(project, 'garment.glb'));
  copyFileSync(join(folder, `${name}.json`), join(project, 'garment.json'));
  copyFileSync(new URL('check_godot.gd', import.meta.url), join(project, 'check_godot.gd'));
  writeFileSync(join(project, 'project.godot'), 'config_version=4\n');
  // As it comes the import takes 15 frames a second and leaves out keys within half a degree.
  writeFileSync(join(project, 'garment.glb.import'), `[remap]
importer="scene"
type="PackedScene"
[deps]
source_file="res://garment.glb"
[params]
animation/fps=30.0
animation/optimizer/enabled=false
`);
  const run = (...words) => spawnSync('xvfb-run', ['-a', 'godot3', '--path', project, ...words,
    '--audio-driver', 'Dummy', '--video-driver', 'GLES2'],
    { encoding: 'utf8', timeout: 1200e3, env: { ...process.env, HOME: project } });
  run('--editor', '--quit');
  return run('-s', 'check_godot.gd');
}

// How many influences a client reads.
const posing = [
  { name: 'babylon.js', package: '@babylonjs/loaders', run: babylon, influences: 8 },
  { name: 'three.js', package: 'three', run: three, influences: 4 },
].filter((client) => installed(client.package));
const found = (program) => !spawnSync(program, ['--help']).error;
const blender = found('blender'), hasGodot = found('godot3') && found('xvfb-run');
if (posing.length === 0 && !installed('gltf-validator') && !blender && !hasGodot) {
  console.log('skipped: no Blender, no Godot, and PROXYCLOTH_CLIENTS names no folder with clients');
  process.exit(77);
}

const folder = mkdtempSync(join(tmpdir(), 'proxycloth-clients-'));
let failures = 0;
const report = (good, text) => {
  console.log(`${good ? 'ok    ' : 'FAILED'} ${text}`);
  failures += good ? 0 : 1;
};
try {
  execFileSync(process.argv[2], [folder]);
  for (const name of ['tube_4', 'tube_8', 'tube_12', 'turning_4', 'sleeve_4']) {
    const glb = readFileSync(join(folder, `${name}.glb`));
    const expected = JSON.parse(readFileSync(join(folder, `${name}.json`)));
    if (installed('gltf-validator')) {
      const { errors, text } = await validator(glb);
      report(errors === 0, `gltf-validator, ${name}: ${errors} errors, ${text}`);
    }
    for (const client of posing.filter((c) => expected.influences <= c.influences)) {
      let largest = 0;
      const { count, extras } = await client.run(glb, expected, (primitive, frame, positions) => {
        largest = Math.max(largest, distance(positions, expected.primitives[primitive][frame]));
      });
      report(count === 3 && largest < 1e-5,
             `${client.name}, ${name}: ${count} meshes, difference ${largest}`);
      report(checkExtras(extras, restPositions(glb)),
             `${client.name}, ${name}: joints, triangles, pins and springs of the proxy`);
    }
  }
  // Blender is the only one that reads 12 influences, Godot 3 reads 4.
  const outside = (client, name, run) => {
    const line = run.stdout.split('\n').find((text) => text.startsWith('difference'));
    report(run.status === 0, `${client}, ${name}: ${line ?? run.stdout + run.stderr}`);
  };
  for (const name of blender ? ['tube_12', 'turning_4', 'sleeve_4'] : []) {
    outside('blender', name, spawnSync('blender', ['--background', '--python-exit-code', '1',
      '--python', new URL('check_blender.py', import.meta.url).pathname, '--',
      join(folder, `${name}.glb`), join(folder, `${name}.json`)], { encoding: 'utf8' }));
  }
  for (const name of hasGodot ? ['tube_4', 'turning_4', 'sleeve_4'] : []) {
    outside('godot', name, godot(folder, name));
  }
} finally {
  rmSync(folder, { recursive: true });
}
process.exit(failures === 0 ? 0 : 1);
