// What the tests in a browser share: the program, the browser, and what a pilot does with both.

import { spawn } from 'node:child_process';
import { mkdirSync } from 'node:fs';
import { createRequire } from 'node:module';
import path from 'node:path';
import { fileURLToPath } from 'node:url';

export const root = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const require = createRequire(path.join(process.env.KESTREL_NODE_MODULES ?? path.join(root, 'target/browser'), 'x.js'));
const { chromium } = require('playwright-core');
export const bin = process.env.KESTREL_BIN ?? path.join(root, 'target/release/kestrel');
export const pictures = path.join(root, 'target/test-logs');
mkdirSync(pictures, { recursive: true });

export const PASSWORD = 'a long enough secret';
export const sleep = (ms) => new Promise((r) => setTimeout(r, ms));
export const seconds = (n) => ({ timeout: n * 1000 });

export class Program {
  static async start(args = [], stateDir = undefined) {
    const p = Program.run(['sim', '--headless', '--mavlink', 'udpserver://127.0.0.1:0', ...(stateDir ? ['--state-dir', stateDir] : []), ...args]);
    await until('the link of the console', () => p.links.length > 0, 10);
    return p;
  }
  /** `kestrel` with any arguments. */
  static run(args) {
    const p = new Program();
    p.begun = performance.now();
    p.child = spawn(bin, args, { stdio: ['ignore', 'pipe', 'inherit'] });
    p.text = '';
    p.child.stdout.on('data', (d) => { p.text += d; });
    return p;
  }
  get links() { return [...this.text.matchAll(/(http:\/\/\S+#enter=\w+)/g)].map((m) => m[1]); }
  get link() { return this.links.at(-1); }
  get url() { return this.link.split('#')[0]; }
  async stop() {
    this.child.kill('SIGINT');
    this.child.kill('SIGINT');
    await Promise.race([new Promise((r) => this.child.once('exit', r)), sleep(3000)]);
    this.child.kill('SIGKILL');
  }
}

export async function until(what, isSo, most) {
  const end = performance.now() + most * 1000;
  for (;;) {
    const value = await isSo();
    if (value) return value;
    if (performance.now() > end) throw new Error(`not within ${most} s: ${what}`);
    await sleep(20);
  }
}

export function check(is, what) {
  if (!is) throw new Error(what);
}

export const state = (page) => page.evaluate(() => ({ ...kestrel.vehicle.state }));
export const waitFor = (page, f, most = 10, arg = undefined) => page.waitForFunction(f, arg, { timeout: most * 1000, polling: 30 });

export async function armAndTakeOff(page) {
  await page.click('text=Take control');
  await waitFor(page, () => document.querySelector('.slide').getAttribute('aria-disabled') === 'false', 20);
  const box = await page.locator('.slide').boundingBox();
  // Half way is no gesture.
  await page.mouse.move(box.x + 25, box.y + 25);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2, box.y + 25, { steps: 4 });
  await page.mouse.up();
  await sleep(300);
  check(!(await state(page)).armed, 'half a slide does not arm');
  await page.mouse.move(box.x + 25, box.y + 25);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width - 4, box.y + 25, { steps: 8 });
  await page.mouse.up();
  await waitFor(page, () => kestrel.vehicle.state.armed);
  await page.click('[data-action=takeoff]');
  await waitFor(page, () => kestrel.vehicle.state.landed === 1 && kestrel.vehicle.state.z > 0.8, 20);
}

export async function clickOnPlan(page, x, y) {
  const at = await page.evaluate(([px, py]) => {
    const box = document.querySelector('canvas.plan').getBoundingClientRect();
    const p = kestrel.view.toScreen(px, py);
    return [p[0] + box.left, p[1] + box.top];
  }, [x, y]);
  await page.mouse.click(...at);
}

/** A pad that a test holds. */
const FAKE_PAD = `
  window.fakePad = null;
  navigator.getGamepads = () => [window.fakePad, null, null, null];
  window.plugPad = () => {
    window.fakePad = { id: 'Fake pad (STANDARD GAMEPAD)', index: 0, connected: true, mapping: 'standard', timestamp: performance.now(), axes: [0, 0, 0, 0], buttons: Array.from({ length: 17 }, () => ({ pressed: false, touched: false, value: 0 })) };
    dispatchEvent(Object.assign(new Event('gamepadconnected'), { gamepad: window.fakePad }));
  };
  window.moveSticks = (axes) => { window.fakePad = { ...window.fakePad, axes, timestamp: performance.now() }; };
  window.unplugPad = () => { const gone = { ...window.fakePad, connected: false }; window.fakePad = null; dispatchEvent(Object.assign(new Event('gamepaddisconnected'), { gamepad: gone })); };
`;

export const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync'],
});

export async function open(url, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1366, height: 768 }, colorScheme: 'dark', locale: 'en-GB', ignoreHTTPSErrors: true, ...options });
  const page = await context.newPage();
  page.errors = [];
  page.on('pageerror', (e) => page.errors.push(e.message));
  page.on('console', (m) => { if (m.type() === 'error' && !/401|ERR_CONNECTION|WebSocket/.test(m.text())) page.errors.push(m.text()); });
  await page.addInitScript(FAKE_PAD);
  await page.goto(url);
  return page;
}
