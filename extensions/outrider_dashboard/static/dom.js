// Helpers for the elements of the page.

export const $ = (id) => document.getElementById(id);
export const known = (value) => value !== null && value !== undefined;

export function setText(element, text) {
  if (element && element.textContent !== text) element.textContent = text;
}

export function setTitle(element, text) {
  if (element && element.title !== text) element.title = text;
}

export function setHtml(element, html) {
  if (element && element.dataset.html !== html) {
    element.dataset.html = html;
    element.innerHTML = html;
  }
}

export function escapeText(text) {
  return String(text).replace(/[&<>"']/g, (letter) => `&#${letter.charCodeAt(0)};`);
}
