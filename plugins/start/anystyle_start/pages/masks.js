// Masks drawn on photographs: what is marked, with a brush or where a click finds one colour, is not part of the scene.
"use strict";
window.maskEditor = ({ h, drawing, save }) => {
  const COLOR = [224, 36, 94], STEPS = 12, AREA = 512; // undone at most; the longer side in pixels on which areas are found
  const photo = h("canvas"), mask = h("canvas", { class: "marks", tabIndex: 0, "aria-label": "Photograph; drag to mark" }), ring = h("i", { class: "ring", hidden: true });
  const options = { willReadFrequently: true }, colors = photo.getContext("2d", options), marks = mask.getContext("2d", options);
  const choice = (name, value, text, checked) => h("label", {}, h("input", { type: "radio", name, value, checked, onchange: () => update() }), text);
  const tools = h("div", { class: "segments", role: "radiogroup", "aria-label": "Tool" }, choice("tool", "brush", "Brush", true), choice("tool", "area", "Area"));
  const deeds = h("div", { class: "segments", role: "radiogroup", "aria-label": "Effect" }, choice("deed", "mark", "Mark", true), choice("deed", "erase", "Erase"));
  const range = (label, min, max, value) => {
    const input = h("input", { type: "range", min, max, value });
    return { root: h("label", { class: "range" }, label, input), get value() { return Number(input.value); } };
  };
  const size = range("Size", 1, 30, 6), likeness = range("Tolerance", 2, 60, 20);
  const button = (text, onclick, options = {}) => h("button", { type: "button", onclick, ...options }, text);
  const undo = button("Undo", () => { if (past.length) { marks.putImageData(past.pop(), 0, 0); update(true); } });
  const clear = button("Clear", () => { remember(); marks.clearRect(0, 0, mask.width, mask.height); update(true); });
  const place = h("span", { class: "soft" }), complaint = h("p", { class: "complaint", role: "alert", hidden: true });
  const arrow = (path) => drawing(24, 24, `<path d="${path}"/>`);
  const previous = button(arrow("M15 5l-7 7 7 7"), () => go(-1), { "aria-label": "Previous photograph" });
  const next = button(arrow("M9 5l7 7-7 7"), () => go(1), { "aria-label": "Next photograph" });
  const done = button("Done", () => attempt(async () => { await keep(); dialog.close(); }), { class: "main" });
  const dialog = h("dialog", { class: "editor", "aria-labelledby": "marked" },
    h("div", { class: "row between" }, h("h2", { id: "marked" }, "Mark what should not be in the scene"), button("×", () => dialog.close(), { class: "quiet", "aria-label": "Close without keeping" })),
    h("div", { class: "drawn" }, photo, mask, ring), complaint,
    h("div", { class: "row" }, tools, deeds, size.root, likeness.root, undo, clear),
    h("div", { class: "row between" }, h("div", { class: "row" }, previous, place, next), done));
  let scene, names, index, past, changed, last = null;

  const value = (name) => dialog.querySelector(`input[name=${name}]:checked`).value;
  const update = (isChanged = changed) => {
    changed = isChanged;
    size.root.hidden = value("tool") !== "brush";
    likeness.root.hidden = value("tool") !== "area";
    undo.disabled = !past.length;
    previous.disabled = index === 0;
    next.disabled = index === names.length - 1;
    place.textContent = `${names[index]}, ${index + 1} of ${names.length}`;
  };
  const remember = () => { past = [...past.slice(1 - STEPS), marks.getImageData(0, 0, mask.width, mask.height)]; };
  const attempt = async (work) => {
    complaint.hidden = true;
    const buttons = [previous, next, done];
    for (const one of buttons) one.disabled = true;
    try {
      await work();
    } catch (error) {
      complaint.textContent = error.message;
      complaint.hidden = false;
    }
    done.disabled = false;
    update();
  };
  const loaded = (address) => new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = () => reject(new Error("The photograph cannot be shown."));
    image.src = address;
  });

  // Pictures of masks are white where the photograph counts; here the rest is coloured.
  const load = async () => {
    const name = names[index], picture = await loaded(`/photograph/${scene.id}/${encodeURIComponent(name)}`);
    for (const canvas of [photo, mask]) Object.assign(canvas, { width: picture.naturalWidth, height: picture.naturalHeight });
    colors.drawImage(picture, 0, 0);
    if (scene.masks[name]) {
      marks.drawImage(await loaded(`/mask/${scene.id}/${encodeURIComponent(name)}?v=${scene.masks[name]}`), 0, 0, mask.width, mask.height);
      const pixels = marks.getImageData(0, 0, mask.width, mask.height);
      for (let i = 0; i < pixels.data.length; i += 4) pixels.data.set([...COLOR, 255 - pixels.data[i]], i);
      marks.putImageData(pixels, 0, 0);
    }
    past = [];
    changed = false;
  };
  const keep = async () => {
    if (!changed) return;
    const pixels = marks.getImageData(0, 0, mask.width, mask.height), written = h("canvas", { width: mask.width, height: mask.height });
    for (let i = 0; i < pixels.data.length; i += 4) pixels.data.fill(pixels.data[i + 3] > 127 ? 0 : 255, i, i + 3), pixels.data[i + 3] = 255;
    written.getContext("2d").putImageData(pixels, 0, 0);
    const file = await new Promise((resolve) => { written.toBlob(resolve, "image/png"); });
    scene = await save(scene.id, names[index], file);
    changed = false;
  };
  const go = (step) => attempt(async () => { await keep(); index += step; await load(); });

  // The connected area around a point whose colours are like those there, and a border of a pixel, as ink on the mask.
  const area = (x, y) => {
    const scale = AREA / Math.max(photo.width, photo.height), width = Math.ceil(photo.width * scale), height = Math.ceil(photo.height * scale);
    const small = h("canvas", { width, height }), context = small.getContext("2d");
    context.drawImage(photo, 0, 0, width, height);
    const picture = context.getImageData(0, 0, width, height), { data } = picture, inside = new Uint8Array(width * height);
    const start = Math.min(height - 1, Math.floor(y * scale)) * width + Math.min(width - 1, Math.floor(x * scale)), far = 3 * (2.55 * likeness.value) ** 2;
    const [red, green, blue] = data.subarray(4 * start, 4 * start + 3), like = (i) => (data[4 * i] - red) ** 2 + (data[4 * i + 1] - green) ** 2 + (data[4 * i + 2] - blue) ** 2 <= far;
    const around = (i) => [i % width ? i - 1 : i, (i + 1) % width ? i + 1 : i, i >= width ? i - width : i, i + width < inside.length ? i + width : i];
    const found = [start];
    inside[start] = 1;
    for (let k = 0; k < found.length; k++) {
      for (const i of around(found[k])) if (!inside[i] && like(i)) { inside[i] = 1; found.push(i); }
    }
    data.fill(0);
    for (const i of found) for (const near of [i, ...around(i)]) data.set([...COLOR, 255], 4 * near);
    context.putImageData(picture, 0, 0);
    marks.drawImage(small, 0, 0, mask.width, mask.height);
  };
  const at = (event) => {
    const { left, top, width, height } = mask.getBoundingClientRect();
    return [(event.clientX - left) * mask.width / width, (event.clientY - top) * mask.height / height];
  };
  const stroke = (from, to) => {
    Object.assign(marks, { lineWidth: size.value / 100 * mask.width, lineCap: "round", strokeStyle: `rgb(${COLOR})` });
    marks.beginPath();
    marks.moveTo(...from);
    marks.lineTo(to[0] + 0.01, to[1]); // so that a dot is drawn, too
    marks.stroke();
  };
  mask.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    mask.setPointerCapture(event.pointerId);
    remember();
    marks.globalCompositeOperation = value("deed") === "erase" ? "destination-out" : "source-over";
    if (value("tool") === "area") area(...at(event)); else { last = at(event); stroke(last, last); }
    update(true);
  });
  mask.addEventListener("pointermove", (event) => {
    const width = size.value / 100 * mask.getBoundingClientRect().width, box = mask.parentElement.getBoundingClientRect();
    ring.hidden = value("tool") !== "brush" || event.pointerType === "touch";
    Object.assign(ring.style, { width: `${width}px`, height: `${width}px`, left: `${event.clientX - box.left}px`, top: `${event.clientY - box.top}px` });
    if (last) { const now = at(event); stroke(last, now); last = now; }
  });
  for (const name of ["pointerup", "pointercancel"]) mask.addEventListener(name, () => { last = null; });
  mask.addEventListener("pointerleave", () => { ring.hidden = true; });
  dialog.addEventListener("keydown", (event) => {
    if (event.key.toLowerCase() === "z" && (event.ctrlKey || event.metaKey)) { event.preventDefault(); undo.click(); }
  });
  document.body.append(dialog);
  return (given, name) => {
    scene = given;
    names = scene.thumbnails.map((each) => each.replace(/\.\d+\.jpg$/, ""));
    index = names.indexOf(name);
    past = [];
    dialog.showModal();
    return attempt(load);
  };
};
