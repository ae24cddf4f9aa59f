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
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** Set a text only where it differs, so that an unchanged frame costs no layout. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** A reason of the console's, as a sentence by itself. */
export function sentence(reason) {
  return `${reason[0].toUpperCase()}${reason.slice(1)}.`;
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
