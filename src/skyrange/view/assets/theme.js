// Colours of the page, read from its style sheet, and of aircraft on light and dark pages.
const THEME_NAMES = /** @type {const} */ (["card", "ink", "dim", "rule", "accent", "bad", "warn", "good", "sky", "ground", "grid", "wall", "roof", "edge"]);
/** @typedef {[number, number, number]} Rgb each from 0 to 1 */
/** @typedef {Record<typeof THEME_NAMES[number], string> & {dark: boolean, version: number}} Theme */

/** @type {Map<string, Rgb>} */
const rgbOfText = new Map();

/** @param {string} hex @returns {Rgb} */
export const rgb = (hex) => {
  let found = rgbOfText.get(hex);
  if (!found) {
    const whole = hex.length === 4 ? hex.replace(/[0-9a-f]/gi, "$&$&") : hex, value = parseInt(whole.slice(1, 7), 16) || 0;
    found = [((value >> 16) & 255) / 255, ((value >> 8) & 255) / 255, (value & 255) / 255];
    rgbOfText.set(hex, found);
  }
  return found;
};

/** Read the colours of an element into a theme. @param {HTMLElement} root @param {Theme} theme */
export const readTheme = (root, theme) => {
  const style = getComputedStyle(root);
  for (const name of THEME_NAMES) theme[name] = style.getPropertyValue("--sky-" + name).trim() || "#888888";
  theme.dark = style.getPropertyValue("--sky-dark").trim() === "1";
  theme.version++;
};

/**
 * The theme of an element, kept up to date.
 * @param {HTMLElement} root @param {() => void} changed @returns {Theme}
 */
export const watchTheme = (root, changed) => {
  const theme = /** @type {Theme} */ ({ dark: false, version: 0 });
  readTheme(root, theme);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    readTheme(root, theme);
    changed();
  });
  return theme;
};

/** @param {{ink: string[]}} one @param {Theme} theme */
export const inkOn = (one, theme) => one.ink[theme.dark ? 1 : 0];
