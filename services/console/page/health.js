// How each service does, one line each; the line says why where something is wrong.

import { make, panel, setText, setTitle } from './element.js';
import { onChange } from './painting.js';
import { header, state } from './state.js';

// A sign and a word stand beside each colour.
const SIGNS = { ok: '●', degraded: '▲', starting: '◌', stopping: '■', silent: '✕' };

export class Health {
  constructor() {
    this.body = make('tbody');
    this.empty = make('p.waiting', {}, 'Waits for the first report of the services (one a second).');
    const head = (text, explanation, name = '') => make(`th${name}`, { scope: 'col', title: explanation }, text);
    this.table = make('table', {},
      make('thead', {}, make('tr', {}, head('service', 'Process'), head('state', 'What it says of itself'),
        head('up', 'Time since it started', '.number'), head('heard', 'Age of its last report, s', '.number'),
        head('lost', 'Messages known to be missing', '.number'), head('bad', 'Messages that could not be used: malformed, set aside, or failed to be handled', '.number'),
        head('reason', 'What is wrong'))), this.body);
    const { root } = panel('health', 'Services', 'How each process does; a reason where one is in trouble.',
      make('div.scroll', { tabindex: '0', 'aria-label': 'Services' }, this.table, this.empty));
    this.root = root;
    this.rows = new Map();
    this.unlisten = [onChange(['services', 'welcome', 'connected', 'second'], () => this.paint())];
  }

  close() {
    this.unlisten.forEach((stop) => stop());
  }

  paint() {
    const services = header('services')?.services ?? [];
    this.empty.hidden = services.length > 0;
    this.table.hidden = !services.length;
    const names = services.map((each) => each.service);
    if (names.join() !== [...this.rows.keys()].join()) {
      this.rows = new Map(names.map((name) => [name, this.row(name)]));
      this.body.replaceChildren(...[...this.rows.values()].map((row) => row.root));
    }
    const since = state.frames.services ? (performance.now() - state.frames.services.arrived) / 1000 : 0;
    for (const each of services) {
      const row = this.rows.get(each.service);
      row.root.dataset.state = each.state;
      setText(row.state, `${SIGNS[each.state] ?? '?'} ${each.state}`);
      setText(row.uptime, span(each.uptime));
      setText(row.age, each.age === null ? '–' : `${(each.age + Math.max(0, since - 1.2)).toFixed(0)} s`);
      setText(row.lost, String(each.lost));
      setText(row.bad, String(each.bad));
      setText(row.reason, each.reason);
      setTitle(row.reason, each.reason);
    }
    this.root.classList.toggle('stale', !state.connected);
  }

  row(name) {
    const cells = {
      state: make('td.state'), uptime: make('td.number'), age: make('td.number'), lost: make('td.number'),
      bad: make('td.number'), reason: make('td.reason'),
    };
    return { ...cells, root: make('tr', {}, make('th', { scope: 'row' }, name), ...Object.values(cells)) };
  }
}

/** Seconds as people say them: 42 s, 3 min, 2 h, 5 d. */
export function span(seconds) {
  if (seconds === null || seconds === undefined) return '–';
  if (seconds < 100) return `${seconds.toFixed(0)} s`;
  if (seconds < 6000) return `${Math.floor(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.floor(seconds / 3600)} h`;
  return `${Math.floor(seconds / 86400)} d`;
}
