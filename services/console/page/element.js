// Elements without markup strings: nothing that comes over the bus is ever parsed as HTML.

/**
 * Make an element.
 * @param {string} tag name, optionally with classes: "div.panel.quiet".
 * @param {Object} attributes "on*" functions become listeners, booleans are set or left out, the rest are attributes.
 * @param {...(Node|string|null)} children
 */
export function make(tag, attributes = {}, ...children) {
  const [name, ...classes] = tag.split('.');
  const element = document.createElement(name);
  if (classes.length) element.className = classes.join(' ');
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith('on')) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, '');
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, value);
  }
  const given = children.filter((child) => child !== null && child !== undefined);
  element.append(...given.map((child) => (typeof child === 'string' ? plain(child) : child)));
  return element;
}

const LONGEST = 2000;

/**
 * Text that somebody else wrote, without what is not seen: control codes, changes of direction. Line breaks become spaces; what is
 * endless ends in an ellipsis. As `vantage.printable` does for terminals.
 */
export function plain(text) {
  const cut = text.length > LONGEST ? `${text.slice(0, LONGEST - 1)}…` : text;
  return cut.replace(/[\n\r\t]/g, ' ').replace(/[\p{Cc}\p{Cf}\p{Cs}\p{Co}\p{Cn}\p{Zl}\p{Zp}]/gu, '');
}

/** Set a text only where it differs, so that an unchanged frame costs no layout. */
export function setText(element, text) {
  const shown = plain(text);
  if (element.textContent !== shown) element.textContent = shown;
}

/** Set the text that a pointer at rest shows. */
export function setTitle(element, text) {
  element.title = plain(text);
}

/** A reason of the console's, as a sentence by itself. */
export function sentence(reason) {
  return `${capital(reason)}.`;
}

/** The text with a capital letter at its beginning. */
export function capital(text) {
  return text[0].toUpperCase() + text.slice(1);
}

/** A titled panel with a one-line explanation, and room for tools at the right of its title. */
export function panel(name, title, explanation, ...children) {
  const tools = make('div.tools');
  const heading = make('h2', { id: `${name}-title` }, title);
  const root = make(`section.panel.${name}`, { 'aria-labelledby': `${name}-title` },
    make('div.panel-head', { title: explanation }, heading, make('p.explanation', {}, explanation), tools),
    ...children);
  return { root, tools };
}

export function button(text, onclick, attributes = {}) {
  return make('button', { type: 'button', onclick, ...attributes }, text);
}

/** A labelled form field. */
export function labelled(text, control, explanation = '') {
  return make('label.field', { title: explanation }, make('span', {}, text), control);
}

export function select(options, value = options[0][0], attributes = {}) {
  return make('select', attributes, ...options.map(([key, text]) => make('option', { value: key, selected: key === value }, text)));
}

export function number(value, minimum, maximum, step = 1, attributes = {}) {
  return make('input', { type: 'number', inputmode: 'decimal', value, min: minimum, max: maximum, step, required: true, ...attributes });
}
