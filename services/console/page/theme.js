// Dark or light: as the system says, until a person chooses.

import { touch } from './painting.js';

const KEPT = 'vantage-theme';
const system = matchMedia('(prefers-color-scheme: light)');

export const theme = () => document.documentElement.dataset.theme;

function apply() {
  document.documentElement.dataset.theme = localStorage.getItem(KEPT) ?? (system.matches ? 'light' : 'dark');
  touch('theme');
}

export function changeTheme() {
  localStorage.setItem(KEPT, theme() === 'dark' ? 'light' : 'dark');
  apply();
}

/** The value of a colour in style.css. */
export function color(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

system.addEventListener('change', apply);
apply();
