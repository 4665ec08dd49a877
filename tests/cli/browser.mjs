// Headless Chromium over its debugging pipe; no package needed.
import { spawn, spawnSync } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

export const chromium = ['chromium', 'chromium-browser', 'google-chrome']
  .find((name) => !spawnSync(name, ['--version']).error);

// Helpers of a browser that has ended may still be writing into its profile.
async function remove(profile) {
  for (let tries = 0; tries < 100; ++tries) {
    try {
      return rmSync(profile, { recursive: true, force: true });
    } catch {
      await new Promise((resolve) => setTimeout(resolve, 100));
    }
  }
}

// Opens a page and calls use({ evaluate, send, problems, requests }): `evaluate` runs an expression
// in the page, `problems` are what it wrote to the console or threw, `requests` what it asked the
// network for besides itself and data URLs.
export async function withPage(url, flags, use) {
  const profile = mkdtempSync(join(tmpdir(), 'proxycloth-browser-'));
  const child = spawn(chromium, ['--headless', '--no-sandbox', '--disable-gpu', '--disable-quic',
    '--no-first-run', '--disable-background-networking', '--disable-component-update',
    '--disable-sync', '--disable-dev-shm-usage', `--user-data-dir=${profile}`,
    '--remote-debugging-pipe', ...flags, 'about:blank'],
    { stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'] });
  const [, , , writer, reader] = child.stdio;
  const waiting = new Map(), problems = [], requests = [], listeners = new Map();
  let last = 0, rest = '', session;
  const ended = new Promise((resolve) => child.on('exit', resolve));
  const send = (method, params = {}) => new Promise((resolve, reject) => {
    waiting.set(++last, { resolve, reject });
    writer.write(JSON.stringify({ id: last, method, params, sessionId: session }) + '\0');
  });
  const on = {
    'Runtime.consoleAPICalled': ({ type, args }) =>
      problems.push(`console.${type}: ${args.map((a) => a.value ?? a.description).join(' ')}`),
    'Runtime.exceptionThrown': ({ exceptionDetails: e }) =>
      problems.push(e.exception?.description ?? e.text),
    'Log.entryAdded': ({ entry }) => problems.push(`${entry.level}: ${entry.text}`),
    'Network.requestWillBeSent': ({ request }) => {
      if (!request.url.startsWith('data:') && request.url !== url) requests.push(request.url);
    },
    'Page.javascriptDialogOpening': ({ message }) => problems.push(`dialog: ${message}`),
  };
  reader.setEncoding('utf8');
  reader.on('data', (text) => {
    const messages = (rest + text).split('\0');
    rest = messages.pop();
    for (const { id, method, params, result, error } of messages.map((m) => JSON.parse(m))) {
      if (id !== undefined) {
        const { resolve, reject } = waiting.get(id);
        waiting.delete(id);
        error ? reject(new Error(error.message)) : resolve(result);
      } else {
        on[method]?.(params);
        listeners.get(method)?.();
      }
    }
  });
  const evaluate = async (expression) => {
    const { result, exceptionDetails } = await send('Runtime.evaluate',
      { expression, returnByValue: true, awaitPromise: true });
    if (exceptionDetails) throw new Error(exceptionDetails.exception?.description);
    return result.value;
  };
  try {
    const { targetInfos } = await send('Target.getTargets');
    const { targetId } = targetInfos.find(({ type }) => type === 'page');
    session = (await send('Target.attachToTarget', { targetId, flatten: true })).sessionId;
    for (const domain of ['Runtime', 'Log', 'Network', 'Page']) await send(`${domain}.enable`);
    const loaded = new Promise((resolve) => listeners.set('Page.loadEventFired', resolve));
    await send('Page.navigate', { url });
    await loaded;
    return await use({ evaluate, send, problems, requests });
  } finally {
    session = undefined;
    send('Browser.close');
    await ended;
    await remove(profile);
  }
}
