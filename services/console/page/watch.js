// Watching: everything there is to see, and the first words to a visitor.

import { Arena } from './arena.js';
import { button, capital, make, sentence } from './element.js';
import { GameBar } from './game_bar.js';
import { Health } from './health.js';
import { onChange, touch } from './painting.js';
import { Predictions } from './predictions.js';
import { ReplayBar } from './replay_bar.js';
import { Robots } from './robots.js';
import { episode, gameOn, ofThisGame, replaying, seriesOn, state, welcome } from './state.js';
import { nameOf, worthOf } from './value_map.js';
import { phaseOf } from './heading.js';

const PATIENCE = 10000; // ms for a prediction

/** The keys of the watching page: [keys, name for people, what they do, action]. */
export const KEYS = [
  [['g'], 'G', 'watch a game: start with what the bar says', (view) => !gameOn() && !replaying() && view.games.begin()],
  [['h'], 'H', 'play the hider', (view) => !replaying() && view.play()],
  [[' ', 'p'], 'space or P', 'pause, go on', (view) => (replaying() ? view.replay.toggle() : seriesOn() && view.games.hold())],
  [['x'], 'X', 'stop the games', (view) => seriesOn() && !replaying() && view.games.end()],
  [['v'], 'V', 'value map on or off', (view) => view.arena.values.show(!state.valuesShown)],
  [['m'], 'M', 'keyboard into the map', (view) => view.arena.stage.focus()],
  [[','], ',', 'replay: 5 s back', (view) => view.replay.by(-5)],
  [['.'], '.', 'replay: 5 s on', (view) => view.replay.by(5)],
];

export class Watch {
  /** @param {(request: Object) => boolean} send @param {() => void} play enters play mode. */
  constructor(send, play) {
    this.send = send;
    this.play = play;
    this.timer = 0;
    this.arena = new Arena((goal) => this.choose(goal));
    this.robots = new Robots();
    this.predictions = new Predictions(send);
    this.health = new Health();
    this.games = new GameBar(send, play);
    this.replay = new ReplayBar(send);
    this.invitation = make('div.invitation', { hidden: true });
    this.arena.root.children[1].before(this.invitation);
    this.root = make('div.watch', {}, make('div.column', {}, this.arena.root, this.health.root),
      make('div.column', {}, this.robots.root, this.predictions.root));
    this.footer = [this.games.root, this.replay.root];
    this.parts = [this.arena, this.robots, this.predictions, this.health, this.games, this.replay];
    this.unlisten = [
      onChange(['hider/plan', 'welcome'], () => this.ownGoal()),
      onChange(['episode', 'session', 'welcome', 'playback', 'connected'], () => this.invite()),
    ];
    this.invite();
  }

  close() {
    this.unlisten.forEach((stop) => stop());
    this.parts.forEach((part) => part.close());
    clearTimeout(this.timer);
  }

  /** Ask what the seeker would see on the way to a goal. */
  choose(goal) {
    const plan = ofThisGame('hider/plan');
    if (!plan) this.arena.say('There is no plan yet to predict along: wait for the first step of a game.');
    else if (plan.unpredictable) this.arena.say(sentence(plan.unpredictable));
    else if (plan.values[goal] === null) this.arena.say(`${capital(nameOf(goal))}: ${worthOf(goal)}; no way leads there.`);
    else if (this.send({ type: 'predict', goal })) {
      state.goal = state.asked = goal;
      clearTimeout(this.timer);
      this.timer = setTimeout(() => {
        if (state.asked !== goal) return;
        state.asked = null;
        touch('goal');
      }, PATIENCE);
    }
    touch('goal');
  }

  /** The first prediction of a game is the one of the hider's own goal, so that the row explains itself. */
  ownGoal() {
    const plan = ofThisGame('hider/plan');
    if (!plan || plan.unpredictable || plan.goal === null || state.auto === plan.episode || state.goal !== null) return;
    state.auto = plan.episode;
    this.choose(plan.goal);
  }

  invite() {
    const on = seriesOn() || replaying() || !state.connected || !welcome();
    this.invitation.hidden = on;
    const game = episode();
    const kind = on ? 'none' : game ? `after ${game.episode} ${game.phase}` : 'first';
    if (this.kind === kind) return;
    this.kind = kind;
    if (on) return;
    const buttons = make('div.buttons', {}, button(game ? 'Watch another game' : 'Watch a game', () => this.games.begin(), { class: 'primary' }),
      button('Play the hider', this.play));
    this.invitation.classList.toggle('small', Boolean(game));
    if (game) {
      const [, text] = phaseOf(game);
      const line = `Game ${game.episode} ${text}${game.caught_step ? ` at step ${game.caught_step}` : ''}${game.phase === 'aborted' && game.reason ? `: ${game.reason}` : ''}`;
      this.invitation.replaceChildren(make('p', {}, line), buttons);
      return;
    }
    this.invitation.replaceChildren(
      make('h2', {}, 'Two small robots play hide-and-seek'),
      make('p', {}, 'The hider looks once, predicts what the seeker will see on every way it could take, and drives where it is least likely to be caught.'),
      buttons, make('p.quiet', {}, 'A game takes half a minute. ? shows the keys.'));
  }
}
