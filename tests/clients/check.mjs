// Opens the GLB files of write_assets in the programs that users have, poses them there, and
// compares with equation (6).
//
//   node check.mjs WRITE_ASSETS
//
// The clients are npm packages that are looked for in the folder PROXYCLOTH_CLIENTS:
//   cd FOLDER && npm install gltf-validator @babylonjs/core @babylonjs/loaders three
// Blender is looked for in PATH (Debian: apt install blender python3-numpy).
// Exit code: 0 all agree, 1 a difference, 77 no client is installed (skipped).
import { execFileSync, spawnSync } from 'node:child_process';
import { existsSync, mkdtempSync, readFileSync, rmSync } from 'node:fs';
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
  engine.dispose();
  return meshes.length;
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
  return meshes.length;
}

// How many influences a client reads.
const posing = [
  { name: 'babylon.js', package: '@babylonjs/loaders', run: babylon, influences: 8 },
  { name: 'three.js', package: 'three', run: three, influences: 4 },
].filter((client) => installed(client.package));
const blender = !spawnSync('blender', ['--version']).error;
if (posing.length === 0 && !installed('gltf-validator') && !blender) {
  console.log('skipped: no Blender, and PROXYCLOTH_CLIENTS names no folder with clients');
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
  for (const influences of [4, 8, 12]) {
    const glb = readFileSync(join(folder, `tube_${influences}.glb`));
    const expected = JSON.parse(readFileSync(join(folder, `tube_${influences}.json`)));
    if (installed('gltf-validator')) {
      const { errors, text } = await validator(glb);
      report(errors === 0, `gltf-validator, ${influences} influences: ${errors} errors, ${text}`);
    }
    for (const client of posing.filter((c) => influences <= c.influences)) {
      let largest = 0;
      const count = await client.run(glb, expected, (primitive, frame, positions) => {
        largest = Math.max(largest, distance(positions, expected.primitives[primitive][frame]));
      });
      report(count === 3 && largest < 1e-5,
             `${client.name}, ${influences} influences: ${count} meshes, difference ${largest}`);
    }
  }
  // The only one that reads 12.
  if (blender) {
    const run = spawnSync('blender', ['--background', '--python-exit-code', '1', '--python',
      new URL('check_blender.py', import.meta.url).pathname, '--',
      join(folder, 'tube_12.glb'), join(folder, 'tube_12.json')], { encoding: 'utf8' });
    const line = run.stdout.split('\n').find((text) => text.startsWith('difference'));
    report(run.status === 0, `blender, 12 influences: ${line ?? run.stderr}`);
  }
} finally {
  rmSync(folder, { recursive: true });
}
process.exit(failures === 0 ? 0 : 1);
