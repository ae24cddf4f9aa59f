// Ties the page together: connection, mode, banner, notices, keys.

import { Connection, takeToken } from './connection.js';
import { make, setText } from './element.js';
import { Heading } from './heading.js';
import { helpDialog, listen } from './keyboard.js';
import { onChange, painted, touch } from './painting.js';
import { Play } from './play.js';
import { PlaySession } from './play_session.js';
import { forgetSecrets, header, receive, replaying, state, welcome } from './state.js';
import { changeTheme } from './theme.js';
import { KEYS, Watch } from './watch.js';

window.vantage = { painted, state };

const [main, footer, banner, notices] = ['main', 'footer', 'banner', 'notices'].map((name) => document.getElementById(name));
const [lost, lostFor] = [make('span'), make('span', { 'aria-hidden': 'true' })]; // the seconds are not read out each second
banner.append(lost, lostFor);
const connection = new Connection(receive, (connected, why) => {
  if (state.connected !== connected) state.since = Date.now();
  Object.assign(state, { connected, why });
  touch('connected');
});
const send = (request) => connection.send(request);

let view = null;

function show(mode) {
  if (view?.root && state.mode === mode) return;
  view?.close();
  const before = state.mode;
  state.mode = mode;
  document.body.dataset.mode = mode;
  if (mode === 'play') {
    forgetSecrets();
    view = new Play(send, () => show('watch'));
  } else {
    view = new Watch(send, () => show('play'));
    // What was not held while playing has to be said again.
    if (before === 'play') connection.renew();
  }
  main.replaceChildren(view.root);
  footer.replaceChildren(...(view.footer ?? []));
  touch('mode');
  touch('welcome');
  if (mode === 'watch') main.focus({ preventScroll: true });
}

function watch() {
  if (state.mode === 'play' && !view.mayLeave()) return;
  show('watch');
}

const actions = { watch, play: () => !replaying() && show('play'), theme: changeTheme, help: () => help.showModal() };
const everywhere = [
  [['t'], 'T', 'dark or light', () => changeTheme()],
  [['?'], '?', 'this list', () => help.showModal()],
];
const playing = (action) => () => (state.mode === 'play' ? action(view) : false);

show(PlaySession.kept() ? 'play' : 'watch');
new Heading(document.getElementById('header'), actions);
const help = helpDialog([...KEYS, ...everywhere]);
listen([
  ...KEYS.map(([keys, name, text, action]) => [keys, name, text, () => (state.mode === 'watch' ? action(view) : false)]),
  ...everywhere,
  [[' ', 'p'], '', '', playing(() => view.session.phase === 'game' && view.session.hold())],
  [['Enter'], '', '', playing(() => !document.activeElement?.closest('button') && view.go())],
  [['Backspace'], '', '', playing(() => view.session.discard())],
  [['i'], '', '', playing(() => view.showView(!view.viewShown))],
  [['Escape'], '', '', playing(() => watch())],
]);

onChange(['connected', 'second', 'welcome'], () => {
  banner.hidden = state.connected || (!connection.opened && Date.now() - state.since < 1500);
  if (banner.hidden) return;
  const seconds = Math.round((Date.now() - state.since) / 1000);
  // What was started again wants a new token; why it refuses this page, a browser does not tell.
  const hint = connection.opened && seconds < 10 ? '' : ' Open the address with #token= that `vantage up` and `vantage status` print.';
  setText(lost, `No connection to the console${state.why ? ` (${state.why})` : ''}; trying again. What you see may be old.${hint}`);
  setText(lostFor, ` ${seconds} s`);
});

onChange(['notice'], () => {
  for (const notice of state.notices.splice(0)) {
    const sign = { info: 'ℹ', warning: '▲', error: '✕' }[notice.level] ?? '';
    const element = make('p', { 'data-level': notice.level }, `${sign} ${notice.text}`);
    notices.append(element);
    setTimeout(() => element.remove(), 8000);
    if (state.mode === 'play' && notice.level !== 'info') view.session.refused(notice.text);
  }
});

onChange(['playback'], () => {
  if (header('playback') && state.mode === 'play') show('watch');
});

setInterval(() => touch('second'), 1000);
takeToken();
window.addEventListener('hashchange', () => takeToken() && location.reload()); // an address was pasted into this tab
connection.open();
