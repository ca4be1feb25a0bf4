"use strict";
// The parts of a page, each filled into the element that names it (data-part).

const data = JSON.parse(document.getElementById("data").textContent);
const degrees = (x) => (x === null || x === undefined ? "–" : `${x.toFixed(2)}°`);
const part = (name) => document.querySelector(`[data-part="${name}"]`);

function figure(image, label, caption, range, onclick, current) {
  const canvas = drawn(image.decoded, label, ...range), text = element("figcaption", {}, ...caption);
  return element("figure", {}, onclick ? element("button", { type: "button", onclick, "aria-label": `${label}: show in 3D`, "aria-current": String(Boolean(current)) }, canvas) : canvas, text);
}

const rangeOf = (images) => [Math.min(...images.map((each) => each.decoded.near)), Math.max(...images.map((each) => each.decoded.far))];

// A loop, or a single estimate: the 3D view with a scrubber over the steps, the curve, all images.
async function loop({ goal, steps, classes, end_deg: end }) {
  await Promise.all([goal, ...steps.map((step) => step.image)].map(decoded));
  const view = new View(classes), range = rangeOf([goal, ...steps.map((step) => step.image)]);
  const slider = element("input", { type: "range", min: 0, max: steps.length - 1, value: 0, "aria-label": "step", oninput: () => go(+slider.value) });
  const text = element("p", { "aria-live": "polite" });
  let timer = null;
  const stop = () => { clearInterval(timer); timer = null; play.textContent = "play"; };
  const play = element("button", { type: "button", onclick: () => {
    if (timer) return stop();
    play.textContent = "pause";
    timer = setInterval(() => (at + 1 < steps.length ? go(at + 1) : stop()), 700);
  } }, "play");
  const scrub = element("div", { class: "scrub" }, element("button", { type: "button", "aria-label": "previous step", onclick: () => go(Math.max(at - 1, 0)) }, "◀"),
    slider, element("button", { type: "button", "aria-label": "next step", onclick: () => go(Math.min(at + 1, steps.length - 1)) }, "▶"), play, text);
  scrub.hidden = steps.length < 2;
  let at = 0, chart = null;
  const words = (step) => `image ${step.index}` + (steps.length > 1 ? ` of ${steps.length - 1}` : "") + `: estimated ${degrees(step.estimated_deg)}` +
    (step.true_deg === null ? "" : `, true ${degrees(step.true_deg)}`) + `, confidence ${percent(step.confidence)}. ${step.message}` + (step.status ? ` [${step.status}]` : "");
  async function go(index) {
    at = index;
    slider.value = index;
    const step = steps[index];
    slider.setAttribute("aria-valuetext", `image ${step.index}`);
    text.textContent = words(step);
    document.querySelectorAll("[data-part=images] button").forEach((button, k) => button.setAttribute("aria-current", String(k === index)));
    if (chart) { const point = chart.series[0].points[index]; chart.mark(point); }
    await view.show({ goal: goal.decoded, current: step.image.decoded, hypotheses: step.hypotheses, belief: step.belief });
  }
  part("view").replaceChildren(scrub, view.root);
  if (part("curve")) {
    chart = new Chart({ title: "Remaining angle at each image", scales: true, pick: go, x: { label: "image", unit: "", low: 0, high: Math.max(steps.length - 1, 1) }, y: { label: "remaining angle", unit: "°", log: true, least: 0.01, zero: true } });
    part("curve").replaceChildren(chart.root);
    const course = (name, label) => ({ label, line: true, marks: true, dash: name === "true_deg" ? false : true, points: steps.filter((step) => step[name] !== null).map((step) => ({ x: step.index, y: step[name], key: step.index, text: `image ${step.index}: ${label} ${degrees(step[name])}` })) });
    const truth = course("true_deg", "true");
    if (end !== null) truth.points.push({ x: steps.length, y: end, key: steps.length - 1, text: `after the last move: true ${degrees(end)}` });
    chart.x.high = Math.max(steps.length - (end === null), 1);
    chart.show([course("estimated_deg", "estimated"), ...(truth.points.length ? [truth] : [])]);
  }
  const bold = (label) => element("b", {}, label);
  part("images").replaceChildren(
    ...steps.map((step, k) => figure(step.image, `Depth image ${step.index}, ${described(step.image)}, estimated ${degrees(step.estimated_deg)} from the goal`,
      [bold(steps.length > 1 ? `${step.index}` : "current"), ` ${degrees(step.estimated_deg)}`, step.status ? `, ${step.status}` : "", step.image.unknown ? `, ${step.image.unknown} px unknown` : ""], range, () => go(k), k === 0)),
    figure(goal, `Goal image, ${described(goal)}`, [bold("goal"), goal.unknown ? `, ${goal.unknown} px unknown` : ""], range));
  if (steps.length === 1) part("images").classList.add("two");
  await go(0);
}

// An evaluation: rows in columns, filtered; any mark opens its pair.
async function evaluation({ columns, names, pairs, classes, bins, command }) {
  const count = columns.error.length, rows = Array.from({ length: count }, (_, k) => k);
  const view = new View(classes), heading = element("h3"), note = element("p", { class: "note" }), images = element("div", { class: "images two" });
  const panel = element("div", { hidden: true }, heading, view.root, images), control = {};
  part("pair").replaceChildren(element("p", { class: "note" }, "Choose a mark of a chart or a row of the table."), note, panel);
  const number = (name, label, value, max) => (control[name] = element("input", { type: "number", min: 0, max, step: "any", value, "aria-label": label, oninput: refresh }));
  const choice = (name, all, values) => (control[name] = element("select", { onchange: refresh }, element("option", { value: "" }, all), ...values.map((value, k) => element("option", { value: k }, value))));
  const top = 180;
  part("filter").replaceChildren(element("form", { class: "filter", onsubmit: (event) => event.preventDefault() },
    element("label", {}, "object", choice("object", "all", names.object)), element("label", {}, "estimator", choice("estimator", "all", names.estimator)),
    element("label", {}, "noise", choice("noise", "all", names.noise)),
    element("label", {}, "angle, degrees", element("span", { class: "pairof" }, number("angle0", "smallest angle", 0, top), number("angle1", "largest angle", top, top))),
    element("label", {}, "confidence", element("span", { class: "pairof" }, number("sure0", "smallest confidence", 0, 1), number("sure1", "largest confidence", 1, 1))),
    element("label", {}, "error, degrees", element("span", { class: "pairof" }, number("error0", "smallest error", 0, top), number("error1", "largest error", top, top)))), (control.count = element("p", { class: "note", "aria-live": "polite" })));
  const name = (row) => `${names.object[columns.object[row]]}, pair ${columns.pair[row]}, ${names.estimator[columns.estimator[row]]}`;
  const text = (row) => `${name(row)}: error ${degrees(columns.error[row])} at ${degrees(columns.angle[row])}` + (columns.confidence[row] === null ? "" : `, confidence ${percent(columns.confidence[row])}`) + (pairs[columns.key[row]] ? "" : " (not embedded)");
  const wide = { label: "symmetry-aware error", unit: "°", log: true, least: 0.02 };
  const make = (title, x, y, levels, scales = false) => new Chart({ title, x, y, levels, scales, pick: (key) => (location.hash = `row=${key}`) });
  const scatter = make("Error of each estimate against its angle", { label: "angle between start and goal", unit: "°" }, { ...wide }, [{ y: 5 }], true);
  const sure = make("Error of each estimate against its confidence", { label: "confidence", unit: "%", low: 0, high: 1 }, { ...wide }, [{ y: 5 }], true);
  const below = make("Share of estimates with an error below a limit", { label: "symmetry-aware error", unit: "°", log: true, least: 0.02 }, { label: "share below", unit: "%", low: 0, high: 1 }, [{ x: 5 }]);
  const reliable = make("Reliability: share of errors below 5 degrees against confidence", { label: "confidence", unit: "%", low: 0, high: 1 }, { label: "share below 5°", unit: "%", low: 0, high: 1 }, [{ diagonal: true }]);
  reliable.pick = (key) => { [control.sure0.value, control.sure1.value] = key; refresh(); };
  part("charts").replaceChildren(scatter.root, below.root, ...(bins ? [sure.root, reliable.root] : []));
  const table = element("tbody"), order = element("select", { "aria-label": "order", onchange: refresh }, element("option", { value: "worst" }, "worst first"), element("option", { value: "best" }, "best first"));
  part("rows").replaceChildren(element("div", { class: "row" }, order), element("div", { class: "wide", tabindex: 0, role: "region", "aria-label": "estimates" }, element("table", {}, element("thead", {}, element("tr", {}, ...["", "object", "estimator", "noise", "angle", "error", "sym.", "confidence"].map((head, k) => element("th", k > 0 && k < 3 ? { class: "word" } : {}, head)))), table)));

  function kept(row) {
    const chosen = (key, value) => control[key].value === "" || +control[key].value === value;
    const inside = (value, low, high) => value >= (control[low].value === "" ? 0 : +control[low].value) && value <= (control[high].value === "" ? Infinity : +control[high].value);
    return chosen("object", columns.object[row]) && chosen("estimator", columns.estimator[row]) && chosen("noise", columns.noise[row]) && inside(columns.angle[row], "angle0", "angle1") &&
      inside(columns.error[row], "error0", "error1") && (columns.confidence[row] === null ? +control.sure0.value <= 0 && +control.sure1.value >= 1 : inside(columns.confidence[row], "sure0", "sure1"));
  }
  function refresh() {
    const shown = rows.filter(kept), of = (k) => shown.filter((row) => columns.estimator[row] === k);
    control.count.textContent = `${shown.length.toLocaleString("en")} of ${count.toLocaleString("en")} estimates`;
    const point = (row, x, y) => ({ x, y, key: row, text: text(row) });
    scatter.show(names.estimator.map((label, k) => ({ label, marks: true, points: of(k).map((row) => point(row, columns.angle[row], columns.error[row])) })));
    below.show(names.estimator.map((label, k) => {
      const sorted = of(k).sort((a, b) => columns.error[a] - columns.error[b]);
      return { label, line: true, points: sorted.map((row, i) => point(row, columns.error[row], (i + 1) / sorted.length)) };
    }));
    if (bins) {
      sure.show(names.estimator.map((label, k) => ({ label, marks: true, points: of(k).filter((row) => columns.confidence[row] !== null).map((row) => point(row, columns.confidence[row], columns.error[row])) })));
      reliable.show(names.estimator.map((label, k) => ({ label, line: true, marks: true, points: (bins[k] || []).map((bin) => ({ x: bin.confidence, y: bin.accuracy, bar: bin.interval, key: [bin.low, bin.high], text: `${label}: ${bin.n} estimates of confidence ${percent(bin.low)} to ${percent(bin.high)}, ${percent(bin.accuracy)} below 5 degrees` })) })));
    }
    const sorted = shown.sort((a, b) => (order.value === "best" ? 1 : -1) * (columns.error[a] - columns.error[b])).slice(0, 40);
    table.replaceChildren(...sorted.map((row) => element("tr", {}, element("td", {}, element("button", { type: "button", "aria-label": `open ${name(row)}`, onclick: () => (location.hash = `row=${row}`) }, pairs[columns.key[row]] ? "open" : "numbers")),
      element("td", { class: "word name" }, `${names.object[columns.object[row]]}, ${columns.pair[row]}`), element("td", { class: "word" }, names.estimator[columns.estimator[row]]),
      ...[names.noise[columns.noise[row]], degrees(columns.angle[row]), degrees(columns.plain[row]), degrees(columns.error[row]), columns.confidence[row] === null ? "–" : percent(columns.confidence[row])].map((cell) => element("td", {}, cell)))));
  }
  async function open() {
    const row = +(location.hash.match(/^#row=(\d+)$/) || [])[1];
    if (!(row >= 0 && row < count)) return;
    const pair = pairs[columns.key[row]];
    note.textContent = pair ? "" : `${text(row)}. To see its images: ${command} --pair ${columns.key[row]}`;
    panel.hidden = !pair;
    if (pair) {
      await Promise.all([pair.current, pair.goal].map(decoded));
      const mine = names.estimator[columns.estimator[row]], hypotheses = [...pair.hypotheses].sort((a, b) => (b.label === mine) - (a.label === mine));
      heading.textContent = `${text(row)}${columns.message[row] ? `; refused: ${columns.message[row]}` : ""}`;
      const range = rangeOf([pair.current, pair.goal]);
      images.replaceChildren(figure(pair.current, `Start image, ${described(pair.current)}`, ["start"], range), figure(pair.goal, `Goal image, ${described(pair.goal)}`, ["goal"], range));
      await view.show({ goal: pair.goal.decoded, current: pair.current.decoded, hypotheses });
    }
    part("pair").closest("section").scrollIntoView({ block: "start" });
  }
  addEventListener("hashchange", open);
  refresh();
  if (location.hash) await open();
}

// The trials of a cell: the final errors by object, the course of the chosen trial, and one loop in 3D.
function cell({ systems, objects, trials, level }) {
  const scatter = new Chart({ title: "Final error of each trial by object", scales: true, pick: course, levels: [{ y: level }], x: { label: `object, 1 to ${objects.length}`, unit: "", low: 0.4, high: objects.length + 0.6 }, y: { label: "final error", unit: "°", log: true, least: 0.02, zero: true } });
  const line = new Chart({ title: "Error at each image", scales: true, levels: [{ y: level }], x: { label: "image", unit: "", low: 0 }, y: { label: "error", unit: "°", log: true, least: 0.02, zero: true } });
  const note = element("p", { class: "note", "aria-live": "polite" });
  const words = (trial) => `${objects[trial.object]}, start ${trial.range}, trial ${trial.trial}, ${systems[trial.system]}: ${degrees(trial.errors.at(-1))} after ${trial.moves} moves. ${trial.reason}`;
  const median = (values) => values.sort((a, b) => a - b)[Math.floor(values.length / 2)];
  function course(key) {
    const all = trials[key];
    note.textContent = `${words(all)} Below: its error at each image beside the medians of all trials.`;
    const last = Math.max(...trials.map((trial) => trial.errors.length));
    const middle = (system) => Array.from({ length: last }, (_, k) => ({ x: k, y: median(trials.filter((trial) => trial.system === system).map((trial) => trial.errors[Math.min(k, trial.errors.length - 1)])) }));
    line.show([...systems.map((label, k) => ({ label: `${label}, median`, line: true, points: middle(k) })), { label: "chosen trial", line: true, marks: true, dash: true, points: all.errors.map((y, x) => ({ x, y, text: `image ${x}: ${degrees(y)}` })) }]);
  }
  part("trials").replaceChildren(element("div", { class: "charts" }, scatter.root, line.root), note, element("ol", { class: "note" }, ...objects.map((name) => element("li", {}, name))));
  scatter.show(systems.map((label, k) => ({ label, marks: true, points: trials.map((trial, key) => ({ trial, key })).filter(({ trial }) => trial.system === k).map(({ trial, key }) => ({ x: trial.object + 1 + 0.5 * ((k + 0.5) / systems.length - 0.5) + 0.02 * (trial.trial % 5 - 2), y: trial.errors.at(-1), key, text: words(trial) })) })));
  course(0);
}

function theme() {
  const root = document.documentElement, button = element("button", { type: "button", class: "theme", onclick: () => set(root.dataset.theme === "dark" ? "light" : "dark") });
  const set = (name) => { root.dataset.theme = name; button.textContent = name === "dark" ? "light colours" : "dark colours"; };
  set(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  document.querySelector(".top").append(button);
}

theme();
(async () => {
  try {
    if (data.loop) await loop(data.loop);
    if (data.evaluation) await evaluation(data.evaluation);
    if (data.cell) cell(data.cell);
    document.documentElement.dataset.ready = "yes";
  } catch (error) {
    document.querySelector(".lead").after(element("p", { class: "note", role: "alert" }, `The interactive parts of this page failed: ${error.message}`));
    throw error;
  }
})();
