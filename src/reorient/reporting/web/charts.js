"use strict";
// Charts of points and lines: linear or logarithmic axes, a point under the mouse or chosen by the keyboard is named.

const SERIES = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "var(--ink)"]; // Okabe and Ito; 3:1 on light and on dark
const MARKS = [
  (x, y) => `M${x - 2.5} ${y - 2.5}h5v5h-5z`, (x, y) => `M${x} ${y - 3.4}l3.4 3.4l-3.4 3.4l-3.4-3.4z`,
  (x, y) => `M${x - 3} ${y + 2.6}l3-5.4l3 5.4z`, (x, y) => `M${x - 3} ${y - 1}h6v2h-6z`, (x, y) => `M${x - 1} ${y - 3}h2v6h-2z`,
];
const colourOf = (index) => SERIES[index % SERIES.length];
const dashOf = (index) => (index < SERIES.length ? null : "5 3");

function svg(tag, attributes = {}, text = null) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) if (value !== null && value !== undefined) made.setAttribute(name, value);
  if (text !== null) made.textContent = text;
  return made;
}

// Ticks of an axis: whole decades (and 2, 5 where there are few), or about five round numbers.
function ticks(low, high, log) {
  if (log) {
    const found = [];
    for (let k = Math.floor(Math.log10(low)); k <= Math.ceil(Math.log10(high)); k++)
      for (const factor of high / low < 100 ? [1, 2, 5] : [1]) found.push(factor * 10 ** k);
    return found.filter((x) => x >= low * 0.999 && x <= high * 1.001);
  }
  const raw = (high - low) / 5, power = 10 ** Math.floor(Math.log10(raw || 1));
  const step = power * ([1, 2, 5, 10].find((x) => x * power >= raw) || 10), found = [];
  for (let x = Math.ceil(low / step) * step; x <= high + step * 1e-6; x += step) found.push(Math.abs(x) < step * 1e-6 ? 0 : x);
  return found;
}

const plain = (x, unit) => (unit === "%" ? `${+(100 * x).toPrecision(3)}%` : `${+x.toPrecision(4)}${unit}`);

// series: {label, points: [{x, y, key, text}], line, marks, dash}; axes: {label, unit, log, low, high}.
class Chart {
  constructor({ title, x, y, levels = [], scales = false, pick = null, height = 300 }) {
    Object.assign(this, { title, x, y: { ...y }, levels, pick, height, series: [], at: null });
    this.least = y.low;
    this.svg = svg("svg", { role: pick ? "application" : "img", "aria-label": title, "aria-roledescription": pick ? "chart" : null, tabindex: pick ? 0 : null });
    this.named = element("p", { class: "named", "aria-live": "polite" }, pick ? "Point at a mark, or focus the chart and use the arrow keys; Enter opens it." : "");
    this.keys = element("ul", { class: "keys" });
    const scale = (log) => element("button", { type: "button", "aria-pressed": String(this.y.log === log), onclick: () => this.rescale(log) }, log ? "logarithmic" : "linear");
    this.buttons = element("div", { class: "row scales", role: "group", "aria-label": "error axis" }, ...(scales ? [scale(true), scale(false)] : []));
    this.root = element("div", { class: "chart" }, element("h3", {}, title), element("div", { class: "row" }, this.keys, this.buttons), this.svg, this.named);
    this.svg.addEventListener("pointermove", (event) => this.nearest(event));
    this.svg.addEventListener("click", (event) => { this.nearest(event); this.open(); });
    this.svg.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.draw()).observe(this.root);
  }

  rescale(log) {
    this.y.log = log;
    [...this.buttons.children].forEach((button) => button.setAttribute("aria-pressed", String((button.textContent === "logarithmic") === log)));
    this.draw();
  }

  show(series) {
    this.series = series;
    this.keys.replaceChildren(...series.map((each, k) => (each.points.length ? element("li", {}, this.sample(each, k), each.label) : "")));
    this.draw();
  }

  sample(each, k) {
    const made = svg("svg", { width: 22, height: 12, "aria-hidden": "true" });
    if (each.line) made.append(svg("path", { d: "M1 6h20", stroke: colourOf(k), "stroke-width": 2, "stroke-dasharray": each.dash ? "4 3" : dashOf(k) }));
    if (each.marks) made.append(svg("path", { d: MARKS[k % MARKS.length](11, 6), fill: colourOf(k) }));
    return made;
  }

  draw() {
    const width = Math.max(this.root.clientWidth, 200), { height } = this, left = 58, right = 22, top = 10, bottom = 44;
    const all = this.series.flatMap((each) => each.points), { x, y } = this;
    const finite = (name) => all.map((point) => point[name]).filter(Number.isFinite);
    const [xs, ys] = [finite("x"), finite("y")];
    const least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity), most = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);
    const range = (axis, values) => {
      let low = axis.low ?? (values.length ? least(values) : 0), high = axis.high ?? (values.length ? most(values) : 1);
      if (axis.log) [low, high] = [Math.max(axis.least ?? 0.01, low > 0 ? low : 0), Math.max(high, 1)];
      else if (axis.zero) low = Math.min(low, 0);
      return low < high ? [low, high] : [low, low + 1];
    };
    const [x0, x1] = range(x, xs), [y0, y1] = range(y, ys);
    const share = (value, low, high, log) => (log ? (Math.log(Math.max(value, low)) - Math.log(low)) / (Math.log(high) - Math.log(low)) : (value - low) / (high - low));
    const X = (value) => left + share(value, x0, x1, x.log) * (width - left - right);
    const Y = (value) => height - bottom - share(Math.min(value, y1), y0, y1, y.log) * (height - top - bottom);
    this.place = (point) => [X(point.x), Y(point.y)];
    const round = (value) => Math.round(10 * value) / 10, parts = [];
    for (const tick of ticks(y0, y1, y.log)) parts.push(svg("path", { class: "grid", d: `M${left} ${round(Y(tick))}H${width - right}` }), svg("text", { x: left - 6, y: round(Y(tick)) + 4, "text-anchor": "end" }, plain(tick, y.unit)));
    for (const tick of ticks(x0, x1, x.log)) parts.push(svg("path", { class: "grid", d: `M${round(X(tick))} ${top}V${height - bottom}` }), svg("text", { x: round(X(tick)), y: height - bottom + 17, "text-anchor": "middle" }, plain(tick, x.unit)));
    parts.push(svg("text", { x: (left + width - right) / 2, y: height - 6, "text-anchor": "middle", class: "axis" }, x.label));
    parts.push(svg("text", { x: 13, y: (height - bottom) / 2, "text-anchor": "middle", class: "axis", transform: `rotate(-90 13 ${(height - bottom) / 2})` }, y.label));
    for (const level of this.levels) parts.push(svg("path", { class: "level", d: level.diagonal ? `M${X(x0)} ${Y(x0)}L${X(x1)} ${Y(x1)}` : level.x !== undefined ? `M${round(X(level.x))} ${top}V${height - bottom}` : `M${left} ${round(Y(level.y))}H${width - right}` }));
    this.series.forEach((each, k) => {
      const at = each.points.map(this.place);
      for (const [j, point] of each.points.entries()) if (point.bar) parts.push(svg("path", { stroke: colourOf(k), "stroke-width": 1.5, d: `M${round(at[j][0])} ${round(Y(point.bar[0]))}V${round(Y(point.bar[1]))}` }));
      if (each.line && at.length) parts.push(svg("path", { d: "M" + at.map(([a, b]) => `${round(a)} ${round(b)}`).join("L"), fill: "none", stroke: colourOf(k), "stroke-width": 2, "stroke-dasharray": each.dash ? "5 4" : dashOf(k) }));
      if (each.marks) parts.push(svg("path", { d: at.map(([a, b]) => MARKS[k % MARKS.length](round(a), round(b))).join(""), fill: colourOf(k), "fill-opacity": all.length > 400 ? 0.7 : 1 }));
    });
    this.ring = svg("circle", { r: 8, class: "ring", visibility: "hidden" });
    this.svg.replaceChildren(...parts, this.ring);
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.svg.setAttribute("height", height);
    if (this.at) this.mark(this.at, false);
  }

  mark(point, tell = true) {
    this.at = point;
    const [x, y] = this.place(point);
    this.ring.setAttribute("cx", x);
    this.ring.setAttribute("cy", y);
    this.ring.setAttribute("visibility", "visible");
    if (tell) this.named.textContent = point.text || "";
  }

  nearest(event) {
    const box = this.svg.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
    let best = null, least = 18;
    for (const each of this.series) for (const point of each.points) {
      if (!point.text) continue;
      const [a, b] = this.place(point), away = Math.hypot(a - x, b - y);
      if (away < least) [best, least] = [point, away];
    }
    if (best) this.mark(best);
    this.near = best;
  }

  open() {
    if (this.near && this.pick) this.pick(this.near.key);
  }

  key(event) {
    const forth = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (event.key === "Enter" && this.at && this.pick) return this.pick(this.at.key);
    if (!forth) return;
    event.preventDefault();
    const points = this.series.flatMap((each) => each.points).filter((point) => point.text).sort((a, b) => a.x - b.x);
    if (points.length) this.mark(points[(points.indexOf(this.at) + forth + points.length) % points.length]);
  }
}
