// More than one: pilots of one drone, drones of one console.

import { spawn, spawnSync } from 'node:child_process';
import { createSocket } from 'node:dgram';
import { existsSync, mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import path from 'node:path';
import readline from 'node:readline';
import { fileURLToPath } from 'node:url';
import { armAndTakeOff, bin, check, open, PASSWORD, pictures, Program, root, seconds, sleep, until, waitFor } from './harness.mjs';

const python = process.env.KESTREL_PYTHON ?? path.join(root, '.venv/bin/python');
const here = path.dirname(fileURLToPath(import.meta.url));

/** A UDP port that nobody has. */
const freePort = () => new Promise((resolve) => {
  const socket = createSocket('udp4');
  socket.bind(0, '127.0.0.1', () => { const { port } = socket.address(); socket.close(() => resolve(port)); });
});

/** pymavlink as a third pilot. */
class Pilot {
  constructor(where, system, seed) {
    this.system = system;
    this.child = spawn(python, [path.join(here, 'pilot.py'), where, String(system), String(seed)], { stdio: ['pipe', 'pipe', 'inherit'] });
    this.heard = [];
    readline.createInterface({ input: this.child.stdout }).on('line', (line) => this.heard.push(JSON.parse(line)));
  }
  async say(word) {
    const from = this.heard.length;
    this.child.stdin.write(`${word}\n`);
    return until(`pymavlink: ${word}`, () => this.heard.slice(from).find((m) => m.kind === word), 8);
  }
  end() { this.child.stdin.end('end\n'); }
}

/** In the page: asks at random, tries to fly, and remembers every ownership it was told. */
function rehearse() {
  const { link, station } = window.kestrel;
  window.told = [];
  link.addEventListener('control', (e) => window.told.push({ at: Date.now(), owner: e.detail.owner?.system ?? 0, lease: e.detail.owner?.lease ?? null, you: !!e.detail.owner?.you }));
  window.askAtRandom = (number) => (number < 0.35 ? station.releaseControl() : station.takeControl(number < 0.8));
  // Through: the vehicle or the page's own socket lets a command pass that flies by its kind.
  window.probe = () => new Promise((resolve) => {
    const to = { target_system: link.target.system, target_component: link.target.component };
    const done = (through) => { link.removeEventListener('message', ack); link.removeEventListener('refused', refused); clearTimeout(timer); resolve(through); };
    const ack = (e) => { const m = e.detail; if (m.name === 'COMMAND_ACK' && m.command === 178 && m.target_system === link.system) done(m.result !== 10); };
    const refused = () => done(false);
    const timer = setTimeout(() => done(null), 3000);
    link.addEventListener('message', ack);
    link.addEventListener('refused', refused);
    link.send('COMMAND_LONG', { ...to, command: 178, confirmation: 0, param1: 0, param2: -1, param3: 0, param4: 0, param5: 0, param6: 0, param7: 0 });
  });
}

export const SEVERAL = {
  async 'two browsers and a pymavlink pilot ask at random: one owner at every instant'() {
    if (!existsSync(python) || spawnSync(python, ['-c', 'import pymavlink']).status !== 0) return { skipped: `no pymavlink in ${python}` };
    const lasts = Number(process.env.KESTREL_OWNERS_S ?? (process.env.KESTREL_FULL === '1' ? 180 : 20));
    const folder = mkdtempSync(path.join(tmpdir(), 'kestrel-owners-'));
    const at = `127.0.0.1:${await freePort()}`;
    const program = await Program.start(['--seed', '11', '--mavlink', `udpserver://${at}`], folder);
    const pilot = new Pilot(at, 245, 11);
    // Numbers that are the same in every run.
    let seed = 11;
    const random = () => { seed = (seed * 1103515245 + 12345) % 2147483648; return seed / 2147483648; };
    try {
      const pages = [];
      for (let i = 0; i < 2; i++) {
        pages.push(await open(program.link));
        await waitFor(pages[i], () => window.kestrel?.vehicle?.state && kestrel.plan, 10);
        await pages[i].evaluate(rehearse);
      }
      await until('the pilot hears the vehicle', async () => (await pilot.say('probe')).through !== null, 20);
      const end = performance.now() + lasts * 1000;
      let [rounds, owned] = [0, 0];
      const owners = new Set();
      while (performance.now() < end) {
        // All at once, and then who is let through.
        await Promise.all([pilot, ...pages].filter(() => random() < 0.7).map((p) => (p === pilot ? pilot.say('ask') : p.evaluate((n) => askAtRandom(n), random()))));
        if (random() < 0.3) await Promise.all([pilot.say('ask'), pages[0].evaluate((n) => askAtRandom(n), random())]);
        await sleep(150);
        const before = await Promise.all(pages.map((p) => p.evaluate(() => kestrel.vehicle.control)));
        const through = await Promise.all([pilot.say('probe').then((r) => r.through), ...pages.map((p) => p.evaluate(() => probe()))]);
        const after = await Promise.all(pages.map((p) => p.evaluate(() => kestrel.vehicle.control)));
        rounds++;
        const system = before[0].owner?.system ?? 0;
        check(before.concat(after).every((c) => (c.owner?.system ?? 0) === system), `the pages do not agree: ${JSON.stringify([before, after])}`);
        // Nobody in control: pages are kept out by their lease, stations of the open policy are not.
        if (!system) continue;
        owned++;
        owners.add(system);
        const mine = [system === pilot.system, ...before.map((c) => c.owner.you)];
        check(through.every((t, i) => t === mine[i]), `owner ${system}: let through ${through}, in control ${mine}`);
        check(mine.filter(Boolean).length === 1, `${mine}`);
      }
      // Every ownership has one owner, whoever told of it, and both pages saw them in the same order.
      const told = await Promise.all(pages.map((p) => p.evaluate(() => window.told)));
      const own = new Map();
      told.forEach((list, i) => list.filter((c) => c.lease !== null).forEach((c) => {
        check(c.you, 'a lease is told to its owner only');
        check((own.get(c.lease) ?? i) === i, `the lease ${c.lease} was told to both pages`);
        own.set(c.lease, i);
      }));
      // From the moment the pilot is the first to be told onwards: changes only, so that telling twice is no change.
      const changes = told.map((list) => list.map((c) => c.owner).filter((o, i, all) => i === 0 || o !== all[i - 1]).join());
      check(changes[0].endsWith(changes[1]) || changes[1].endsWith(changes[0]), `two stories: ${changes[0]} and ${changes[1]}`);
      console.log(`FIGURES ${lasts} s, ${rounds} rounds, ${owned} of them with an owner (${owners.size} different), ${own.size} leases of pages: one owner each time`);
      check(owned >= 3 && owners.size >= 2, 'hardly anybody had control');
      for (const page of pages) await page.context().close();
    } finally {
      pilot.end();
      await program.stop();
      rmSync(folder, { recursive: true, force: true });
    }
  },

  async 'one console for two drones: an administrator adds and assigns them, a pilot flies his own and is refused the other'() {
    const [east, west] = await Promise.all([Program.start(['--seed', '13']), Program.start(['--seed', '14'])]);
    const folder = mkdtempSync(path.join(tmpdir(), 'kestrel-several-'));
    const console_ = Program.run(['console', '--state-dir', folder, '--listen', '127.0.0.1:0', '--vehicle', `east=${east.link}`]);
    try {
      const setup = await until('the code for the first user', () => console_.text.match(/http:\S+#setup=\w+/)?.[0], 10);
      await until('the first vehicle', () => console_.text.includes('Vehicle east'), 10);
      const boss = await open(setup);
      await boss.fill('input[name=username]', 'boss');
      await boss.fill('input[name=password]', PASSWORD);
      await boss.click('button.primary');
      await boss.waitForSelector('[data-vehicle=east] .dot.good', seconds(10));
      // The second one by the page.
      await boss.fill('.adding input >> nth=0', west.link);
      await boss.fill('.adding input >> nth=1', 'west');
      await boss.click('.adding button.primary');
      await boss.waitForSelector('[data-vehicle=west]', seconds(10));
      for (const name of ['ana', 'ben']) {
        await boss.fill('.rail form input >> nth=0', name);
        await boss.fill('.rail form input >> nth=1', PASSWORD);
        await boss.selectOption('.rail form select', 'pilot');
        await boss.click('text=Add user');
        await boss.waitForSelector(`.rail li b:text-is("${name}")`, seconds(5));
      }
      await boss.click('[data-key="ana east"]');
      await boss.click('[data-key="ben west"]');
      await boss.waitForSelector('[data-key="ana east"][aria-pressed=true]', seconds(5));
      await boss.waitForSelector('[data-key="ben west"][aria-pressed=true]', seconds(5));
      for (const theme of ['dark', 'light']) {
        await boss.evaluate((t) => { document.documentElement.dataset.theme = t; }, theme);
        await sleep(300);
        await boss.screenshot({ path: path.join(pictures, `console-several-${theme}.png`) });
      }
      const site = setup.split('#')[0];
      const login = async (name) => {
        const page = await open(site);
        await page.fill('input[name=username]', name);
        await page.fill('input[name=password]', PASSWORD);
        await page.click('button.primary');
        // The only vehicle is opened by itself.
        await waitFor(page, () => window.kestrel?.vehicle?.state && kestrel.plan, 15);
        return page;
      };
      const [ana, ben] = [await login('ana'), await login('ben')];
      check(await ana.evaluate(() => kestrel.session.vehicle.name) === 'east', 'ana has east');
      check(await ben.evaluate(() => kestrel.session.vehicle.name) === 'west', 'ben has west');
      await armAndTakeOff(ana);
      check(!(await ben.evaluate(() => kestrel.vehicle.state.armed)), 'the other stands');
      await ana.waitForSelector('text=You have control', seconds(3));
      await ana.screenshot({ path: path.join(pictures, 'console-several-flying.png') });
      const refused = await ana.evaluate(async () => [(await fetch('/api/vehicles/west/plan')).status, await new Promise((r) => { const s = new WebSocket(`ws://${location.host}/api/vehicles/west/socket`); s.onopen = () => r('open'); s.onerror = () => r('refused'); })]);
      check(refused.join() === '403,refused', refused.join());
      // Latency by two hops.
      const ms = await ana.evaluate(() => kestrel.link.latency);
      console.log(`FIGURES a page through a console off the drone: ${ms.toFixed(1)} ms to the drone and back`);
      await ana.keyboard.press('l');
      await waitFor(ana, () => !kestrel.vehicle.state.armed, 25);
      // Taken away: out, and back at the list with nothing in it.
      await boss.click('[data-key="ana east"]');
      await ana.waitForSelector('text=No vehicle is assigned to you', seconds(5));
      for (const page of [boss, ana, ben]) {
        check(page.errors.filter((e) => !/40[34]/.test(e)).length === 0, page.errors.join('; '));
        await page.context().close();
      }
    } finally {
      await Promise.all([east.stop(), west.stop(), console_.stop()]);
      rmSync(folder, { recursive: true, force: true });
    }
  },
};
