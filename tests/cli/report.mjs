// Makes results, one of them with a hostile name and one failed, and opens their page in Chromium.
//
//   node report.mjs PROXYCLOTH DATA_FOLDER
//
// Exit code: 0 all good, 1 a difference, 77 no Chromium is installed (what needs none was checked).
import { execFileSync, spawnSync } from 'node:child_process';
import { copyFileSync, mkdirSync, mkdtempSync, readFileSync, rmSync, statSync,
         writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';
import { chromium, withPage } from './browser.mjs';

const [program, data] = process.argv.slice(2);
const folder = mkdtempSync(join(tmpdir(), 'proxycloth-report-'));
const hostile = '<img src=x onerror=alert(1)> "&amp; <script>';
let failures = 0;
function check(good, text) {
  console.log(`${good ? 'ok    ' : 'FAILED'} ${text}`);
  failures += good ? 0 : 1;
}
const report = (...words) => spawnSync(program, ['report', ...words], { encoding: 'utf8' });

function makeResults() {
  const quick = ['--vertices', '48', '--frames', '12', '--rounds', '2', '--quiet'];
  execFileSync(program, ['build', join(data, 'makehuman_fedora.obj'), '-o',
    join(folder, 'run/garments/hat'), '--name', hostile, '--strip', ...quick]);
  execFileSync(program, ['build', join(data, 'dedo_apron_2_dense.obj'), '-o',
    join(folder, 'run/garments/apron'), '--name', 'apron', ...quick]);
  const broken = join(folder, 'run/garments/broken');
  mkdirSync(broken);
  writeFileSync(join(broken, 'broken.batch.json'), JSON.stringify({
    schema: 1, id: 'broken', path: 'broken.fbx', outcome: 'failed', code: 6, error: 'importer',
    retryable: true, message: 'broken.fbx: </script><script>alert(2)</script>', results: [] }));
  writeFileSync(join(broken, 'broken.log'), '<img src=x onerror=alert(3)>\n');
  writeFileSync(join(folder, 'run/other.json'), '{"something": "else"}');
  writeFileSync(join(folder, 'run/damaged.json'), '{"stage_count": 9, "stages": ');
}

const readReport = (path) => JSON.parse(readFileSync(join(folder, path)));

// The order of rows and cards, and the values of a column in that order.
const order = (key) => `(() => {
  const rows = [...document.querySelectorAll('#measures tbody tr')];
  const index = [...document.querySelectorAll('#measures thead th')]
    .findIndex((th) => th.dataset.key === '${key}');
  return { rows: rows.map((row) => row.querySelector('th').textContent),
           cards: [...document.querySelectorAll('.card h3')].map((name) => name.textContent),
           values: rows.map((row) => Number(row.children[index].dataset.value)),
           mark: document.querySelectorAll('#measures thead th')[index].ariaSort };
})()`;
const click = (key) =>
  `document.querySelector('#measures th[data-key="${key}"] button').click()`;
const pictures = `Promise.all([...document.querySelectorAll('.card img')].map((image) => {
  image.loading = 'eager';
  return image.decode().then(() => image.naturalWidth, () => 0);
}))`;
const rising = (values) => values.every((value, i) => i === 0 || values[i - 1] <= value);

async function checkPage({ evaluate, problems, requests }) {
  const first = await evaluate(order('worst'));
  check(first.rows.length === 2 && rising([...first.values].reverse()) &&
    first.mark === 'descending', `worst measure first: ${first.values}`);
  check(String(first.cards) === String(first.rows), 'contact sheets in the order of the table');
  check(first.rows.includes(hostile), 'a name that looks like HTML is shown as text');
  const reports = { [hostile]: readReport(`run/garments/hat/${hostile}.json`),
                    apron: readReport('run/garments/apron/apron.json') };
  for (const key of ['hausdorff', 'min_angle_worst', 'edge_ratio_mean']) {
    await evaluate(click(key));
    const falling = await evaluate(order(key));
    await evaluate(click(key));
    const back = await evaluate(order(key));
    check(rising([...falling.values].reverse()) && rising(back.values) &&
      back.mark === 'ascending' && String(back.cards) === String(back.rows) &&
      back.rows.every((name, i) => reports[name].measures[key] === back.values[i]),
      `sorted by ${key}: ${back.values}`);
  }
  const widths = await evaluate(pictures);
  check(widths.length === 3 && Math.min(...widths) > 1000, `pictures are whole: ${widths}`);
  const counted = await evaluate(`[...document.querySelectorAll('#shapes figure')].map((figure) =>
    [...figure.querySelectorAll('title')].map((t) => parseInt(t.textContent.split(': ')[1]))
      .reduce((a, b) => a + b))`);
  const triangles = Object.values(reports).reduce((sum, r) => sum + r.measures.triangles, 0);
  check(counted.length === 4 && counted.every((count) => count === triangles),
    `histograms hold all ${triangles} triangles: ${counted}`);
  const text = await evaluate('document.body.innerText');
  check(text.includes('broken.fbx: </script>') && text.includes('importer, exit code 6'),
    'the failure is shown with its cause');
  check((await evaluate("document.querySelectorAll('#time .bar').length")) === 9,
    'time of every stage');
  const warnings = Object.values(reports).flatMap((r) => r.warnings.map((w) => w.message));
  check(warnings.length > 0 && warnings.every((message) => text.includes(message)),
    `every warning: ${warnings.length}`);
  check(await evaluate("document.querySelectorAll('#options tbody tr').length") > 60,
    'options are listed');
  check(await evaluate(`document.querySelector('a[href$="apron.glb"]').getAttribute('href')`) ===
    './garments/apron/apron.glb', 'the results are linked');
  check(await evaluate("document.querySelectorAll('img[onerror], main script').length") === 0,
    'no markup came from a file');
  check(problems.length === 0, `nothing on the console: ${problems}`);
  check(requests.length === 0, `nothing is fetched: ${requests}`);
}

// Copies of one garment, more than fit into a page as whole pictures.
function makeMany(count) {
  for (let i = 0; i < count; ++i) {
    const to = join(folder, 'many', `g${i}`);
    mkdirSync(to, { recursive: true });
    copyFileSync(join(folder, 'run/garments/apron/apron.png'), join(to, `apron${i}.png`));
    writeFileSync(join(to, `apron${i}.json`),
      JSON.stringify({ ...readReport('run/garments/apron/apron.json'), name: `apron${i}` }));
  }
}

async function checkMany({ evaluate, problems, requests }) {
  const widths = await evaluate(pictures);
  check(widths.length === 40 && widths.every((width) => width >= 400 && width <= 960),
    `40 garments have thumbnails of ${widths[0]} pixels`);
  check(problems.length + requests.length === 0, `quiet: ${problems} ${requests}`);
}

try {
  makeResults();
  makeMany(40);
  const page = join(folder, 'run/report.html');
  let run = report(join(folder, 'run'));
  check(run.status === 0 && run.stdout + run.stderr === '', `report runs: ${run.stderr}`);
  const bytes = readFileSync(page);
  report(join(folder, 'run'), '-o', join(folder, 'elsewhere.html'));
  report(join(folder, 'run'));
  check(readFileSync(page).equals(bytes), 'a second run writes the same bytes');
  check(bytes.toString().split('</script>').length === 3, 'no text ends a script');
  run = report(join(folder, 'many'));
  const size = statSync(join(folder, 'many/report.html')).size;
  check(run.status === 0 && size < 40e6, `a page of 40 garments has ${size} bytes`);
  mkdirSync(join(folder, 'empty'));
  check(report(join(folder, 'empty')).status === 3, 'a folder without results is refused');
  check(report(join(folder, 'missing')).status === 3, 'a missing folder is refused');
  check(report(join(folder, 'run'), '-o', '/proc/x.html').status === 4, 'no place for the page');
  if (chromium !== undefined) {
    await withPage(pathToFileURL(page).href, [], checkPage);
    await withPage(pathToFileURL(join(folder, 'elsewhere.html')).href, [], async ({ evaluate }) =>
      check(await evaluate(`document.querySelectorAll('a[href^="./"]').length`) === 0,
        'a page elsewhere has no links to files'));
    await withPage(pathToFileURL(join(folder, 'many/report.html')).href, [], checkMany);
  }
} finally {
  rmSync(folder, { recursive: true });
}
if (failures === 0 && chromium === undefined) {
  console.log('skipped: no Chromium to open the page with');
  process.exit(77);
}
process.exit(failures === 0 ? 0 : 1);
