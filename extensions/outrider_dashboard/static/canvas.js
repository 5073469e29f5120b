// Canvas helpers: scaling to the screen's pixels, axis ticks, text.

export const FONT = "Roboto, system-ui, sans-serif";

// Return the canvas's context in CSS pixels, with a backing store in device pixels.
export function fit(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

// Return about `count` round numbers between two limits.
export function ticks(low, high, count) {
  const span = high - low;
  if (!(span > 0)) return [low];
  const raw = span / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].map((k) => k * power).find((s) => s >= raw * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k += 1) found.push(Number((k * step).toPrecision(12)));
  return found;
}

// Return a color as an RGBA pixel, little-endian.
export function pixel(color, opacity = 1) {
  const value = parseInt(color.slice(1), 16);
  return ((Math.round(255 * opacity) << 24) | ((value & 255) << 16) | (value & 0xff00) | (value >> 16)) >>> 0;
}

// Draw a grid of bytes as an image, with a table of pixels; row 0 is y = 0.
export function paint(image, { columns, rows }, cells, table) {
  const bytes = atob(cells);
  if (image.width !== columns || image.height !== rows) [image.width, image.height] = [columns, rows];
  const context = image.getContext("2d");
  const pixels = context.createImageData(columns, rows);
  const target = new Uint32Array(pixels.data.buffer);
  for (let row = 0; row < rows; row += 1) {
    const to = (rows - 1 - row) * columns;
    for (let column = 0; column < columns; column += 1) target[to + column] = table[bytes.charCodeAt(row * columns + column)];
  }
  context.putImageData(pixels, 0, 0);
}

// Trace a square with a tip at a heading [rad], from east to north.
export function pointed(c, x, y, size, heading) {
  const [cos, sin] = [Math.cos(heading), -Math.sin(heading)];
  for (const [ahead, aside] of [[-0.9, -0.9], [0.5, -0.9], [1.6, 0], [0.5, 0.9], [-0.9, 0.9]]) {
    c.lineTo(x + size * (ahead * cos - aside * sin), y + size * (ahead * sin + aside * cos));
  }
  c.closePath();
}

export function colorOf(list, index) {
  return list[index % list.length];
}

// Write a text in which "_x" marks a subscript; return its width.
export function write(c, text, x, y, size = 12) {
  let at = x;
  for (const [, sub, plain] of text.matchAll(/_(.)|([^_]+)/g)) {
    c.font = `${sub ? size * 0.75 : size}px ${FONT}`;
    c.fillText(sub || plain, at, y + (sub ? size * 0.28 : 0));
    at += c.measureText(sub || plain).width;
  }
  return at - x;
}
