"use strict";
// RESULTS is in figures.js.
const { methods, metrics, scenes, styles, cells, wholes } = RESULTS;

// ---- small tools
const find = (selector, within = document) => within.querySelector(selector);
const all = (selector, within = document) => [...within.querySelectorAll(selector)];
const say = (text) => { find("#status").textContent = text; };
const fill = (node, attributes, children) => {
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
};
const make = (tag, attributes = {}, ...children) => fill(document.createElement(tag), attributes, children);
const draw = (tag, attributes = {}, ...children) => fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
// A score as JSON and attributes hold it.
const value = (figure) => figure === "inf" ? Infinity : figure === "-inf" ? -Infinity : parseFloat(figure ?? "");
const number = (figure) => {
  const size = Math.abs(figure);
  if (Number.isNaN(size)) return "–";
  if (size === Infinity) return figure > 0 ? "inf" : "-inf";
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return figure.toExponential(2);
  return size < 1000 ? String(Number(figure.toPrecision(4))) : figure.toFixed(0);
};
// The better of two scores first; what is unknown last.
const compareBy = (better) => (a, b) => Number.isNaN(a) - Number.isNaN(b) || (a === b ? 0 : (a < b) === (better === "lower") ? -1 : 1);

// ---- tables
const columns = (table) => all("thead th", table);
const cellOf = (row, head) => row.cells[head.cellIndex];
const known = (cell) => value(cell.dataset.value);

const sortBy = (table, head) => {
  const back = { ascending: "descending", descending: "ascending" };
  const order = head.ariaSort ? back[head.ariaSort] : head.dataset.first;
  const compare = compareBy(order === "ascending" ? "lower" : "higher");
  const sign = order === "ascending" ? 1 : -1;
  const words = (a, b) => sign * a.dataset.value.localeCompare(b.dataset.value);
  const numbers = (a, b) => compare(known(a), known(b));
  const rule = head.classList.contains("words") ? words : numbers;
  for (const other of columns(table)) other.removeAttribute("aria-sort");
  head.ariaSort = order;
  table.tBodies[0].append(...[...table.tBodies[0].rows].sort((a, b) => rule(cellOf(a, head), cellOf(b, head))));
  say(`Sorted by ${head.innerText.trim()}, ${order}`);
};

const ranks = ["best", "second"];
const rank = (marked, numbers, better) => {
  const best = [...new Set(numbers.filter((one) => !Number.isNaN(one)))].sort(compareBy(better));
  marked.forEach((node, index) => {
    const name = ranks[best.indexOf(numbers[index])];
    if (name) node.dataset.rank = name;
    else delete node.dataset.rank;
  });
};

const markBest = (table) => {
  for (const head of columns(table).filter((one) => one.dataset.better)) {
    const rows = [...table.tBodies[0].rows];
    const nodes = rows.map((row) => cellOf(row, head));
    rank(nodes, rows.map((row, index) => row.hidden || "baseline" in row.dataset ? NaN : known(nodes[index])), head.dataset.better);
    for (const node of nodes) for (const mark of all(".mark", node)) mark.textContent = { best: " best", second: " second best" }[node.dataset.rank] ?? "";
  }
};

const filter = (form, tables) => {
  const wanted = form.words.value.trim().toLowerCase();
  const chosen = new Set(all("[name=column]:checked", form).map((box) => box.value));
  const lacking = (row) => !row.cells[0].dataset.value.toLowerCase().includes(wanted)
    || (form.consistent.checked && !("consistent" in row.dataset))
    || (form.baselines.checked && "baseline" in row.dataset);
  for (const table of tables) {
    for (const row of table.tBodies[0].rows) row.hidden = lacking(row);
    for (const cell of all("[data-name]", table)) if (cell.dataset.name in metrics) cell.hidden = !chosen.has(cell.dataset.name);
    markBest(table);
  }
  say(tables.map((table) => `${all("tbody tr:not([hidden])", table).length} of ${table.tBodies[0].rows.length} methods`).join("; "));
};

const startTables = () => {
  const form = find("#filters");
  const tables = all("table.results");
  form.addEventListener("input", () => filter(form, tables));
  form.addEventListener("submit", (event) => event.preventDefault());
  for (const table of tables) {
    table.tHead.addEventListener("click", (event) => { if (event.target.closest("button")) sortBy(table, event.target.closest("th")); });
    table.tBodies[0].addEventListener("click", (event) => {
      if (event.target.closest("button")) openBehind(event.target.closest("tr").dataset.method, table.dataset.guide, event.target.closest("td").dataset.name);
    });
  }
  filter(form, tables); // what a browser kept of the form when the page was loaded again
};

// ---- the pictures behind a number
const behind = (method, guide, metric) => Object.entries(cells[method]).flatMap(([place, cell]) => {
  const [scene, style] = place.split("/");
  const whole = wholes[`${method}/${scene}/${guide}`] ?? {};
  const own = metric in cell.figures;
  return styles[style].guide === guide ? [{ scene, style, cell, own, figure: cell.status === "done" ? value(own ? cell.figures[metric] : whole[metric]) : NaN }] : [];
}).sort((a, b) => compareBy(metrics[metric].better)(a.figure, b.figure));

// A cell's views lie below each other in one file; a tile shows the first, and opens all.
const picture = (scene, cell, file) => {
  const { views, size } = scenes[scene];
  return cell.status === "done"
    ? make("div", { class: "strip", style: `--views:${views};--ratio:${size.join("/")}` }, make("img", { src: `${file}.avif`, alt: "", loading: "lazy", decoding: "async" }))
    : make("div", { class: "said", style: `--ratio:${size.join("/")}` }, cell.status === "missing" ? cell.message || "not run" : `${cell.status === "timeout" ? "too slow" : "failed"}: ${cell.message}`);
};

const tile = (method, { scene, style, cell, figure, own }) => {
  const file = `cells/${method}/${scene}/${style}`;
  const { guide, title } = styles[style];
  return make("li", {},
    make(...(cell.status === "done" ? ["a", { href: `${file}.avif` }] : ["div", {}]),
      picture(scene, cell, file),
      make("b", {}, number(figure), own || Number.isNaN(figure) ? "" : " (the scene's)"),
      make("span", {}, `${scene}, ${style}`)),
    guide === "text" ? make("q", {}, title) : make("img", { class: "style", src: `styles/${style}.avif`, alt: title, title, loading: "lazy" }));
};

const openBehind = (method, guide, metric) => {
  const dialog = find("#behind");
  const { title, seeds } = methods[method];
  find("h2", dialog).textContent = `${title}: ${metrics[metric].title}`;
  find("p", dialog).textContent = `Every scene and style guided by ${guide}s, best first. Press one to see all its views.${seeds > 1 ? " Pictures and scores here are one seed's." : ""}`;
  find("ul", dialog).replaceChildren(...behind(method, guide, metric).map((one) => tile(method, one)));
  dialog.showModal();
  dialog.scrollTop = 0;
};

// ---- cost against quality
const ticks = (low, high, count) => {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((one) => one * power >= rough);
  return Array.from({ length: Math.floor(high / step) - Math.ceil(low / step) + 1 }, (_, index) => (Math.ceil(low / step) + index) * step);
};
const decades = (low, high) => {
  const steps = high / low > 3000 ? [1] : [1, 2, 5];
  const powers = Array.from({ length: Math.ceil(Math.log10(high)) - Math.floor(Math.log10(low)) + 1 }, (_, index) => 10 ** (Math.floor(Math.log10(low)) + index));
  return powers.flatMap((power) => steps.map((step) => step * power)).filter((one) => one >= low && one <= high);
};
const overlap = (a, b) => a.x < b.x + b.width && b.x < a.x + a.width && a.y < b.y + b.height && b.y < a.y + a.height;

const points = (guide, metric) => all(`table[data-guide="${guide}"] tbody tr`).flatMap((row) => {
  const cell = find(`[data-name="${metric}"]`, row);
  const seconds = value(row.dataset.seconds);
  const mean = cell ? known(cell) : NaN;
  const [low, high] = cell ? [value(cell.dataset.low), value(cell.dataset.high)] : [NaN, NaN];
  return Number.isFinite(mean) ? [{ ...methods[row.dataset.method], seconds, mean, low: Number.isNaN(low) ? mean : low, high: Number.isNaN(high) ? mean : high }] : [];
});

const marker = (point, x, y) => {
  const kind = point.baseline ? "point baseline" : point.consistent ? "point" : "point flat";
  return point.baseline ? draw("rect", { class: kind, x: x - 4, y: y - 4, width: 8, height: 8 }) : draw("circle", { class: kind, cx: x, cy: y, r: 4.5 });
};

// The words at the nearest free place beside a point, with a line to it where that is not next to it.
const label = (words, x, y, width, taken) => {
  const wide = 7.2 * words.length;
  const places = [0, -16, 16, -32, 32, -48, 48].flatMap((down) => [x + 9, x - 9 - wide, x - wide / 2].map((left) => ({ x: left, y: y - 8 + down, width: wide, height: 16, down })));
  const boxes = places.filter((one) => one.x >= 0 && one.x + wide <= width);
  const box = boxes.find((one) => !taken.some((other) => overlap(one, other))) ?? boxes[0];
  taken.push(box);
  const near = Math.min(Math.max(x, box.x), box.x + wide);
  return [...(box.down ? [draw("line", { class: "leader", x1: x, y1: y, x2: near, y2: box.down < 0 ? box.y + 14 : box.y + 2 })] : []), draw("text", { x: box.x, y: box.y + 12 }, words)];
};

const scale = (low, high, from, to) => (one) => from + (to - from) * (high > low ? (one - low) / (high - low) : 0.5);

const plot = (form) => {
  const [guide, metric] = [form.guide.value, form.metric.value];
  const every = points(guide, metric);
  find("#key").replaceChildren();
  const shown = every.filter((point) => point.seconds > 0);
  const without = every.filter((point) => !(point.seconds > 0)).map((point) => point.title);
  find("#unplotted").textContent = without.length ? `Without seconds, and so not here: ${without.join(", ")}.` : "";
  if (!shown.length) return find("#plot").replaceChildren(make("p", {}, "No method has this score and its seconds."));
  const [width, height, left, bottom] = [Math.min(find("#plot").clientWidth, 1000), 440, 56, 44];
  const range = (numbers, pad) => [Math.min(...numbers) - pad(numbers), Math.max(...numbers) + pad(numbers)];
  const spread = (numbers) => 0.06 * (Math.max(...numbers) - Math.min(...numbers)) || Math.abs(numbers[0]) || 1;
  const [low, high] = range(shown.flatMap((point) => [point.low, point.high]), spread);
  const seconds = shown.map((point) => point.seconds);
  const [fast, slow] = [Math.min(...seconds) / 1.6, Math.max(...seconds) * 1.6];
  const logarithm = scale(Math.log10(fast), Math.log10(slow), left, width - 12);
  const across = (one) => logarithm(Math.log10(one));
  const up = scale(low, high, height - bottom, 26);
  const { title, better } = metrics[metric];
  const svg = draw("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${title} against CPU seconds per style; the numbers are in the table` });
  for (const one of ticks(low, high, 6)) {
    svg.append(draw("line", { class: "grid", x1: left, x2: width, y1: up(one), y2: up(one) }));
    svg.append(draw("text", { class: "tick", x: left - 8, y: up(one) + 4, "text-anchor": "end" }, number(one)));
  }
  for (const one of decades(fast, slow)) {
    svg.append(draw("line", { class: "grid", x1: across(one), x2: across(one), y1: 20, y2: height - bottom }));
    svg.append(draw("text", { class: "tick", x: across(one), y: height - bottom + 18, "text-anchor": "middle" }, number(one)));
  }
  svg.append(draw("text", { x: 0, y: 12 }, `${title}, ${better} is better`));
  svg.append(draw("text", { x: width - 4, y: height - 6, "text-anchor": "end" }, "CPU seconds per style"));
  const taken = shown.map((point) => ({ x: across(point.seconds) - 6, y: up(point.mean) - 6, width: 12, height: 12 }));
  const names = shown.map((point) => point.title.length > 26 ? `${point.title.slice(0, 25)}…` : point.title);
  const narrow = width < 600;
  if (narrow) find("#key").append(...shown.map((point) => make("li", {}, point.title)));
  for (const [index, point] of shown.entries()) {
    const [x, y] = [across(point.seconds), up(point.mean)];
    const words = draw("title", {}, `${point.title}: ${number(point.mean)}, ${number(point.seconds)} s`);
    const line = draw("line", { class: point.baseline ? "point baseline" : "point", x1: x, x2: x, y1: up(point.low), y2: up(point.high), "stroke-opacity": 0.5 });
    svg.append(draw("g", {}, words, line, marker(point, x, y)), ...label(narrow ? String(index + 1) : names[index], x, y, width, taken));
  }
  return find("#plot").replaceChildren(svg);
};

const startPlot = () => {
  const form = find("#axes");
  if (!form.guide.length) return;
  form.addEventListener("input", () => plot(form));
  new ResizeObserver(() => plot(form)).observe(find("#plot"));
};

startTables();
startPlot();
