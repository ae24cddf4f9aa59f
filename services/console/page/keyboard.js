// The keys of the watching page, in one table, and the dialogue that shows them.

import { button, make } from './element.js';

const PLAYING = [
  ['↑ or W, ↓ or S', 'forward, backward (hold to keep going)'],
  ['← or A, → or D', 'turn left, turn right'],
  ['gamepad', 'left stick or cross: drive; Start: pause'],
  ['space or P', 'pause, go on'],
  ['Enter', 'begin; next game'],
  ['Backspace', 'discard the last game (between games)'],
  ['I', 'show or hide the state image'],
  ['Esc', 'end the session'],
];
const IN_THE_MAP = [['Tab, or M', 'into the map'], ['arrow keys', 'from goal to goal'], ['Enter', 'what would the seeker see on the way there?']];

/**
 * Listen for the keys of the watching page.
 * @param {Array<[string[], string, string, Function]>} table keys, their name for people, what they do, the action.
 */
export function listen(table) {
  // A button that was clicked with the mouse gives the keyboard back: the next space is not meant for it.
  addEventListener('click', (event) => event.detail && event.target.closest('button')?.blur());
  addEventListener('keydown', (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    if (document.querySelector('dialog[open]')) return;
    if (event.target.closest('input:not([type="range"]), select, textarea')) return;
    if (event.key === ' ' && event.target.closest('button')) return; // space presses a button
    for (const [keys, , , action] of table) {
      if (keys.includes(event.key.length === 1 ? event.key.toLowerCase() : event.key) && action() !== false) {
        event.preventDefault();
        return;
      }
    }
  });
}

/** The dialogue that shows all keys. */
export function helpDialog(table) {
  const rows = (pairs) => pairs.map(([keys, text]) => make('tr', {}, make('th', { scope: 'row' }, make('kbd', {}, keys)), make('td', {}, text)));
  const section = (title, pairs) => make('section', {}, make('h3', {}, title), make('table', {}, make('tbody', {}, ...rows(pairs))));
  const dialog = make('dialog', { 'aria-labelledby': 'keys-title' },
    make('h2', { id: 'keys-title' }, 'Keys'),
    make('div.key-columns', {},
      make('div', {}, section('Watching', table.map(([, name, text]) => [name, text])), section('In the map', IN_THE_MAP)),
      section('Playing the hider', PLAYING)),
    make('form', { method: 'dialog' }, button('Close', () => dialog.close())));
  document.body.append(dialog);
  return dialog;
}
