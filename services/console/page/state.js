// What is known: the newest frame of each key, and what accumulates over a game (driven paths, true seeker views).

import { touch } from './painting.js';

export const ROBOTS = ['hider', 'seeker'];
const DRIVING = /^(welcome|episode|tick|services|recording|score|session|playback|notice|hider\/(color|view))$/;

export const state = {
  connected: false,
  since: Date.now(), // of the present connection state
  why: '', // what the server said when it closed
  mode: 'watch', // or 'play'
  frames: {}, // key -> {header, payload, arrived}
  paths: { hider: [], seeker: [] }, // [step, x, y] of the game `pathsOf`
  pathsOf: null,
  past: new Map(), // step -> Uint8Array [128 * 128] true seeker view
  pastOf: null, // episode
  goal: null, // selected: a prediction is wanted
  asked: null, // goal whose prediction is under way
  auto: null, // episode whose own goal was asked about unasked
  valuesShown: true,
  notices: [],
};

export const header = (key) => state.frames[key]?.header ?? null;
export const payload = (key) => state.frames[key]?.payload ?? null;
export const welcome = () => header('welcome');
export const episode = () => header('episode');

/** Whether a game is set up or running. */
export const gameOn = () => ['setup', 'running'].includes(episode()?.phase);
/** Whether there is something to stop: a game is on, or others follow. */
export const seriesOn = () => gameOn() || Boolean(header('session')?.more_games);
/** Whether there is a pause that can be taken back, also between games. */
export const held = () => Boolean(header('session')?.paused);
/** Whether the step clock of a running game goes. */
export const clockRuns = () => episode()?.phase === 'running' && !episode().paused && (header('playback')?.state ?? 'playing') === 'playing';
/** s after which a picture of a running game should have been replaced. */
export const patience = () => Math.max(1.5, 4 * episode().rules.step_period);
export const replaying = () => header('playback') !== null;
/** The step reached in the present game. */
export function step() {
  const game = episode()?.episode;
  const tick = header('tick');
  const said = episode()?.step ?? 0; // of a game that is over: its last
  return tick && tick.episode === game ? Math.max(tick.step, said) : said;
}

/** A frame's header if it is of the present game, else null. */
export function ofThisGame(key) {
  const found = header(key);
  return found && found.episode === episode()?.episode ? found : null;
}

/** The plan of the present game: {header, path: Float32Array [n * 3]} or null. */
export function plan() {
  const found = ofThisGame('hider/plan');
  if (!found) return null;
  const bytes = payload('hider/plan');
  return { header: found, path: new Float32Array(bytes.slice().buffer) };
}

/** Take in one frame. */
export function receive(head, bytes) {
  const key = head.key;
  if (key === 'welcome') forget();
  // While a person plays, this page does not even hold what the player must not see.
  if (state.mode === 'play' && !DRIVING.test(key)) return;
  if (key.startsWith('past/')) {
    remember(head.episode, head.step, bytes);
    touch('past');
    return;
  }
  if (head.forget) forgetShown(); // a replay went to another place
  if (key === 'episode' && isNewGame(head)) forgetGame();
  state.frames[key] = { header: head, payload: bytes, arrived: performance.now() };
  if (key === 'seeker/view') remember(head.episode, head.step, bytes);
  if (key === 'prediction') state.asked = null;
  if (key === 'notice') state.notices.push(head);
  if (key === 'driven') catchUp(head);
  const robot = key.endsWith('/pose') && key.slice(0, -5);
  if (robot) extend(robot, head);
  touch(key, head.stamp);
}

function isNewGame(head) {
  const before = episode();
  return before !== null && (before.episode !== head.episode || before.seed !== head.seed);
}

/** Forget everything but the connection: the server is about to say all of it again. */
function forget() {
  state.frames = {};
  forgetGame();
}

function forgetShown() {
  const { welcome: greeting, services, recording, score, session } = state.frames;
  const kept = { welcome: greeting, services, recording, score, session };
  state.frames = Object.fromEntries(Object.entries(kept).filter(([, frame]) => frame));
  forgetGame();
}

function forgetGame() {
  state.paths = { hider: [], seeker: [] };
  state.pathsOf = null;
  state.past = new Map();
  state.pastOf = null;
  state.goal = state.asked = state.auto = null;
  delete state.frames.prediction;
  touch('goal');
  touch('past');
}

/** Forget what a player must not see. */
export function forgetSecrets() {
  for (const key of Object.keys(state.frames)) if (!DRIVING.test(key)) delete state.frames[key];
  forgetGame();
}

const MARK = 'vantage-driven';

function extend(robot, pose) {
  if (state.pathsOf !== pose.episode) {
    state.pathsOf = pose.episode;
    state.paths = recalled(pose.episode) ?? { hider: [], seeker: [] };
  }
  const path = state.paths[robot];
  while (path.length && path[path.length - 1][0] >= pose.step) path.pop(); // a replay went back
  path.push([pose.step, pose.x, pose.y]);
}

/** What was driven before this page came. */
function catchUp({ episode: number, hider, seeker }) {
  if (state.pathsOf !== null && state.pathsOf !== number) return;
  state.pathsOf = number;
  const merged = (early, late) => [...early.filter(([at]) => !late.length || at < late[0][0]), ...late];
  state.paths = { hider: merged(hider, state.paths.hider), seeker: merged(seeker, state.paths.seeker) };
}

/** The driven paths survive a reload of the page: the bus only says where the robots are now. */
function recalled(number) {
  try {
    const kept = JSON.parse(sessionStorage.getItem(MARK));
    return kept && number > 0 && kept.episode === number && kept.seed === episode()?.seed ? kept.paths : null;
  } catch {
    return null;
  }
}

addEventListener('pagehide', () => {
  if (state.mode === 'play' || state.pathsOf === null) sessionStorage.removeItem(MARK);
  else sessionStorage.setItem(MARK, JSON.stringify({ episode: state.pathsOf, seed: episode()?.seed, paths: state.paths }));
});

function remember(number, at, bytes) {
  if (state.pastOf !== number) {
    if (state.past.size) state.past = new Map(); // another one only where something is forgotten
    state.pastOf = number;
  }
  state.past.set(at, bytes);
  touch('past');
}
