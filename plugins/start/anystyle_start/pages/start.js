// The start page: every text from outside becomes a text node, never HTML.
(() => {
  "use strict";
  const byId = (id) => document.getElementById(id);
  const token = document.querySelector("meta[name=token]").content, main = byId("main");
  const TEXTS = ["thick oil paint in orange and navy", "pink and mint watercolor", "charcoal drawing", "stained glass", "golden autumn light"];
  const NOUNS = { photographs: ["photograph", "photographs"], example: ["photograph", "photographs"], film: ["film", "film"], splat: ["splat", "splats"] };
  const ACTIVE = ["waiting", "running"];
  let editor, choices, state = { scenes: [], pictures: [] }, view = null, timer, lost = false;
  const uploads = new Map(); // by scene: what is on its way

  // Elements
  const h = (name, options = {}, ...children) => {
    const element = document.createElement(name);
    for (const [key, value] of Object.entries(options)) {
      if (value === undefined || value === null || value === false) continue;
      if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
      else if (key in element && !key.startsWith("aria") && key !== "list") element[key] = value;
      else element.setAttribute(key === "class" ? "class" : key, value === true ? "" : value);
    }
    element.append(...children.flat(9).filter((child) => child !== null && child !== undefined && child !== false));
    return element;
  };
  const drawing = (width, height, content) => // of constant text
    new DOMParser().parseFromString(`<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 ${width} ${height}" fill="none" stroke="currentColor" stroke-width="2" stroke-linecap="round" stroke-linejoin="round" aria-hidden="true">${content}</svg>`, "image/svg+xml").documentElement;
  const fill = (element, ...children) => { element.replaceChildren(...children.flat(9).filter(Boolean)); return element; };
  const count = (number, kind) => `${number} ${(NOUNS[kind] ?? NOUNS.photographs)[number === 1 ? 0 : 1]}`;
  const capital = (text) => /^\S+\.\w/.test(text) ? text : text.charAt(0).toUpperCase() + text.slice(1); // names of files stay
  const lasted = (seconds) => seconds < 90 ? `${Math.round(seconds)} s` : `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s`;
  const megabytes = (bytes) => bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
  const when = (seconds) => new Date(1000 * seconds).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });

  // Requests
  const complain = (text) => {
    byId("trouble").textContent = text;
    byId("trouble").hidden = !text;
    clearTimeout(complain.timer);
    if (text) complain.timer = setTimeout(() => complain(""), 15000);
  };
  const say = (text) => { if (byId("said").textContent !== text) byId("said").textContent = text; };
  const post = async (path, body = {}) => {
    const raw = body instanceof Blob;
    let answer;
    try {
      answer = await fetch(path, { method: "POST", body: raw ? body : JSON.stringify(body), headers: { "X-Anystyle-Token": token, "Content-Type": raw ? "application/octet-stream" : "application/json" } });
    } catch {
      throw new Error("The program does not answer. If it has ended, start it again: anystyle view");
    }
    const reply = await answer.json().catch(() => ({ error: `an answer of status ${answer.status}` }));
    if (!answer.ok) throw new Error(capital(reply.error ?? "something went wrong"));
    return reply;
  };
  const attempt = async (work) => {
    try {
      complain("");
      return await work();
    } catch (error) {
      complain(error.message);
      return undefined;
    }
  };
  let settle = () => {};
  const question = ({ title, detail = "", yes, name }) => new Promise((resolve) => {
    const dialog = byId("ask"), answer = byId("answer");
    byId("question").textContent = title;
    byId("detail").textContent = detail;
    byId("yes").textContent = yes;
    byId("answer-label").hidden = name === undefined;
    answer.value = name ?? "";
    // Not by the event "close", which comes later, maybe when the next question is open.
    settle = (yes) => { dialog.close(); resolve(yes ? (name === undefined ? true : answer.value) : null); };
    dialog.showModal();
    if (name !== undefined) answer.select();
  });
  byId("ask").addEventListener("submit", (event) => { event.preventDefault(); settle(Boolean(event.submitter?.value)); });
  byId("ask").addEventListener("cancel", (event) => { event.preventDefault(); settle(false); });
  // Enter in the dialog's field means its main button.
  byId("answer").addEventListener("keydown", (event) => { if (event.key === "Enter") { event.preventDefault(); settle(true); } });

  // Where the page is
  const place = () => {
    const [, scene = "", part = ""] = location.hash.split("/");
    return { scene: /^[0-9a-f]{12}$/.test(scene) ? scene : "", part };
  };
  const go = (hash) => { if (location.hash === hash) refresh(); else location.hash = hash; };

  // Uploads
  const suffixOf = (name) => name.slice(name.lastIndexOf(".")).toLowerCase();
  const kindOf = (file) => Object.keys(choices.suffixes).find((kind) => choices.suffixes[kind].includes(suffixOf(file.name)));
  const filesOf = async (transfer) => {
    const files = [...transfer.files], entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
    if (!entries.some((entry) => entry.isDirectory)) return files;
    const inside = async (entry) => {
      if (entry.isFile) {
        const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
        return [Object.assign(file, { isMask: /\/masks?\//i.test(entry.fullPath) })];
      }
      const reader = entry.createReader(), found = [];
      for (;;) {
        const part = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
        if (!part.length) break;
        found.push(...part);
      }
      // Of a folder, what cannot be read is left out without a word.
      return (await Promise.all(found.map(inside))).flat().filter(kindOf);
    };
    const all = (await Promise.all(entries.map(inside))).flat();
    return Object.assign(all, { folder: entries.length === 1 ? entries[0].name : "" });
  };
  const send = async (scene, file, on) => {
    const upload = Array.from(crypto.getRandomValues(new Uint8Array(10)), (byte) => byte.toString(16).padStart(2, "0")).join("");
    for (let offset = 0; offset < file.size; offset += choices.limits.part) {
      const query = new URLSearchParams({ name: file.name, upload, offset, total: file.size });
      const part = file.slice(offset, offset + choices.limits.part);
      await post(`/scenes/${scene}/files?${query}`, part);
      on(part.size);
    }
  };
  const add = async (files, scene) => {
    const refused = [], taken = [];
    for (const file of files) {
      const kind = kindOf(file);
      if (!kind) refused.push(`${file.name} is no photograph, film or splat that can be read.`);
      else if (!file.size) refused.push(`${file.name} is empty.`);
      else if (file.size > choices.limits[kind]) refused.push(`${file.name} has ${megabytes(file.size)}; at most ${megabytes(choices.limits[kind])} are taken.`);
      else taken.push(file);
    }
    const kinds = new Set(taken.map(kindOf));
    if (kinds.size > 1 || (!kinds.has("photographs") && taken.length > 1)) {
      refused.push("A scene is made of photographs, or one film, or one splat: drop one kind at a time.");
      taken.length = 0;
    }
    if (!taken.length) { complain(refused.slice(0, 3).join(" ")); return undefined; }
    const id = scene || (await attempt(() => post("/scenes", { title: files.folder ?? "" })))?.id;
    if (!id) return undefined;
    const now = uploads.get(id) ?? { bytes: 0, sent: 0, files: 0, done: 0, failed: [] };
    uploads.set(id, now);
    now.failed.push(...refused);
    now.bytes += taken.reduce((sum, file) => sum + file.size, 0);
    now.files += taken.length;
    if (!scene) go(`#/${id}`);
    const line = [...taken];
    const worker = async () => {
      for (let file = line.shift(); file; file = line.shift()) {
        try {
          await send(id, file, (bytes) => { now.sent += bytes; view?.update(); });
        } catch (error) {
          now.failed.push(error.message);
        }
        now.done += 1;
        refresh();
      }
    };
    await Promise.all([worker(), worker(), worker()]);
    if (now.done === now.files) {
      uploads.delete(id);
      if (now.failed.length) complain([...new Set(now.failed)].slice(0, 4).join(" "));
      await refresh();
    }
    return id;
  };
  const keepMask = async (scene, name, file) => {
    await post(`/scenes/${scene}/masks?name=${encodeURIComponent(name)}`, file);
    await refresh();
    return state.scene;
  };
  const addMasks = async (files, scene) => {
    const names = files.map((file) => file.name.toLowerCase()), twice = files.find((file, i) => names.indexOf(names[i]) < i), failed = [];
    if (twice) { complain(`Two masks are named ${twice.name}: masks go by the names of their photographs.`); return; }
    for (const file of files) await keepMask(scene, file.name, file).catch((error) => failed.push(error.message));
    say(`${files.length - failed.length} masks added.`);
    if (failed.length) complain(failed.slice(0, 3).join(" ") + (failed.length > 3 ? ` And ${failed.length - 3} more.` : ""));
  };
  const addPicture = (file) => attempt(async () => {
    if (file.size > choices.limits.picture) throw new Error(`${file.name} has ${megabytes(file.size)}; at most ${megabytes(choices.limits.picture)} are taken.`);
    const { name } = await post(`/pictures?name=${encodeURIComponent(file.name)}`, file);
    await refresh();
    return name;
  });
  const picker = (label, { many = true, accept, main: isMain = false, on }) => {
    const input = h("input", { type: "file", multiple: many, accept: accept.join(","), onchange: () => { on([...input.files]); input.value = ""; } });
    return h("label", { class: `button file${isMain ? " main" : ""}` }, input, label);
  };

  // Dropped anywhere
  const holdsFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  let ends;
  const over = (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    byId("over").hidden = false;
    clearTimeout(ends); // a drag that is given up ends without a word
    ends = setTimeout(() => { byId("over").hidden = true; }, 1000);
  };
  addEventListener("dragenter", over);
  addEventListener("dragover", over);
  addEventListener("drop", async (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    byId("over").hidden = true;
    const files = await filesOf(event.dataTransfer).catch(() => []);
    const scene = state.scene, extends_ = view?.name === "form" && scene && (!scene.kind || scene.kind === "photographs");
    if (event.target.closest?.("[data-styles]") && files.length && files.every((file) => kindOf(file) === "photographs")) {
      for (const file of files) view.choose?.(await addPicture(file));
      return;
    }
    const onMasks = event.target.closest?.("[data-masks]"), masks = files.filter((file) => onMasks || file.isMask), others = files.filter((file) => !masks.includes(file));
    const id = others.length ? await add(Object.assign(others, { folder: files.folder }), extends_ ? scene.id : "") : view?.name === "form" && scene?.id;
    if (masks.length && id) await addMasks(masks, id);
    else if (masks.length) complain("Masks belong to photographs: drop these first.");
  });
  // The page of a scene says which style it shows.
  addEventListener("message", (event) => view?.told?.(event));
  addEventListener("beforeunload", (event) => { if (uploads.size) event.preventDefault(); });

  // Parts of views
  const advice = () => {
    const camera = (x, y, turn) => `<path transform="translate(${x} ${y}) rotate(${turn})" d="M-7 -5h14v10h-14z M-3 -5l1 -3h4l1 3"/>`;
    const arc = [-60, -30, 0, 30, 60].map((turn) => {
      const angle = turn * Math.PI / 180;
      return camera(80 + 62 * Math.sin(angle), 22 + 62 * Math.cos(angle), -turn);
    }).join("");
    const fan = [-50, -25, 0, 25, 50].map((turn) => `<path d="M80 82L${80 + 58 * Math.sin(turn * Math.PI / 180)} ${82 - 58 * Math.cos(turn * Math.PI / 180)}" stroke-dasharray="2 5"/>`).join("");
    const thing = '<path d="M68 34h24v-14l-12 -10l-12 10z" stroke-width="2.5"/>';
    return [
      h("div", { class: "pair" },
        h("div", {}, drawing(160, 100, thing + arc), h("span", { class: "yes" }, "A step sideways for each")),
        h("div", {}, drawing(160, 100, thing + fan + camera(80, 86, 0)), h("span", { class: "no" }, "Not turning on the spot"))),
      h("ul", {},
        h("li", {}, "Eight to twenty-four photographs, each sharing two thirds with the last."),
        h("li", {}, "In focus, in even light, and with nothing moving."),
        h("li", {}, "Of things with texture: blank walls, glass and water give no points to hold on to."),
        h("li", {}, "Or a slow film, walked sideways or around."))];
  };
  const picture = (address, alt = "") => address ? h("img", { src: address, alt, loading: "lazy", decoding: "async" }) : h("div", { class: "blank", "aria-hidden": "true" });
  const strip = (scene, { remove, draw } = {}) => {
    const list = h("ul", { class: `strip${scene.thumbnails.length > 24 ? " many" : ""}` });
    const left = new Set(scene.result?.left_out ?? []);
    let shown = "";
    const update = (now) => {
      const named = now.thumbnails.join("\n") + [...(now.result?.left_out ?? [])] + Object.entries(now.masks);
      if (named === shown) return;
      shown = named;
      fill(list, now.thumbnails.map((name) => {
        const file = name.replace(/\.\d+\.jpg$/, "");
        const button = remove && now.kind === "photographs" && h("button", { type: "button", "aria-label": `Remove ${file}`, title: "Remove", onclick: () => remove(file) }, "×");
        const mask = now.masks[file], drawn = [picture(`/thumbnail/${now.id}/${encodeURIComponent(name)}`, file), mask && h("img", { class: "mask", src: `/mask/${now.id}/${encodeURIComponent(file)}?v=${mask}`, alt: "" })];
        const note = left.has(file) ? "left out" : mask ? "masked" : now.transparent.includes(file) ? "cut out" : undefined;
        return h("li", { class: left.has(file) ? "out" : undefined, "data-note": note },
          draw && now.kind !== "film" ? h("button", { type: "button", class: "draw", "aria-label": `Mark in ${file}`, title: "Mark what should not be in the scene", onclick: () => draw(file) }, drawn) : drawn, button);
      }));
    };
    update(scene);
    return { list, update };
  };
  const rename = (scene) => attempt(async () => {
    const title = await question({ title: "Rename this scene", yes: "Rename", name: scene.title });
    if (title !== null) await post(`/scenes/${scene.id}/rename`, { title });
    await refresh();
  });
  const remove = (scene) => attempt(async () => {
    const sure = await question({ title: `Delete “${scene.title}”?`, detail: "Its photographs, results and downloads on this page are deleted. This cannot be undone.", yes: "Delete" });
    if (!sure) return;
    await post(`/scenes/${scene.id}/delete`);
    go("#/");
    await refresh();
  });
  const heading = (text) => h("h1", { tabIndex: -1 }, text);

  // The first view: drop something, or go back to a scene
  const home = () => {
    const list = h("ul", { class: "cards" }), recent = h("section", { class: "below", "aria-labelledby": "recent" }, h("h2", { id: "recent" }, "Recent scenes"), list);
    const accept = Object.values(choices.suffixes).flat();
    const example = (name) => attempt(async () => { go(`#/${(await post("/scenes", { example: name })).id}`); });
    const zone = h("section", { class: "drop", "aria-label": "Add photographs" },
      drawing(54, 54, '<path d="M27 36V12M18 20l9 -9l9 9M8 34v8a4 4 0 0 0 4 4h30a4 4 0 0 0 4 -4v-8"/>'),
      h("strong", {}, "Drop photographs, a film or a splat here"),
      picker("Choose files", { accept, main: true, on: (files) => add(files, "") }),
      choices.captures.map((name) => h("p", { class: "soft" }, "Nothing at hand? ", h("button", { type: "button", class: "quiet", onclick: () => example(name) }, `Take the ${name} that comes along`))));
    const root = h("div", {},
      heading("Photographs in, a scene in any style out"),
      h("p", { class: "lead" }, "Photographs of a place become a 3D scene, painted in your words or like a picture. Everything happens on this machine, and nothing leaves it."),
      h("div", { class: "columns" }, zone, h("section", { class: "panel advice" }, h("h2", {}, "Which photographs to take"), advice())),
      recent);
    const about = (scene) => ({ running: "Being made …", waiting: "Waits for its turn", failed: "Did not work out", interrupted: "Interrupted", cancelled: "Cancelled" })[scene.state] ?? (scene.picture ? "" : "Not made yet");
    let shown = "";
    const update = () => {
      const now = JSON.stringify(state.scenes);
      if (now === shown) return;
      shown = now;
      recent.hidden = !state.scenes.length;
      const focused = document.activeElement?.dataset?.key;
      fill(list, state.scenes.map((scene) => h("li", { class: "card" },
        h("a", { href: `#/${scene.id}`, "data-key": scene.id },
          picture(scene.picture ?? (scene.thumbnails[0] && `/thumbnail/${scene.id}/${encodeURIComponent(scene.thumbnails[0])}`)),
          h("div", { class: "words" }, h("h3", {}, scene.title), h("p", {}, [about(scene), count(scene.count, scene.kind), scene.named && when(scene.created)].filter(Boolean).join(" · ")))),
        h("div", { class: "row" },
          h("button", { type: "button", class: "quiet", "aria-label": `Rename ${scene.title}`, onclick: () => rename(scene) }, "Rename"),
          h("button", { type: "button", class: "quiet", "aria-label": `Delete ${scene.title}`, onclick: () => remove(scene) }, "Delete")))));
      if (focused) list.querySelector(`[data-key="${focused}"]`)?.focus();
    };
    return { name: "home", title: "anystyle", root, update };
  };

  // A scene that is yet to be made, or made anew
  const notice = (scene, without) => {
    if (scene.state === "failed" && scene.reasons.length) {
      return h("section", { class: "panel", "data-notice": "" }, h("h2", {}, "The cameras were not found"),
        h("div", { class: "halves" },
          h("div", {}, h("p", {}, "To build a scene, the program has to find where each photograph was taken. Here it could not:"),
            h("ul", { class: "reasons" }, scene.reasons.map((reason) => h("li", {}, reason))),
            h("p", {}, "Add photographs below, or take out those that show something else, and make the scene again.")),
          h("div", { class: "advice" }, advice())),
        without && scene.without_cameras && h("p", { class: "hint" }, "Or make do with what a network guesses, which is rough: ", h("button", { type: "button", class: "quiet", onclick: () => without(scene.without_cameras) }, "use no cameras")));
    }
    const texts = { failed: ["This did not work out", capital(scene.error)], interrupted: ["Interrupted", "The program ended while this scene was being made. Make it again: what was finished is not computed twice."], cancelled: ["Cancelled", "Nothing was kept of this run."] };
    if (!texts[scene.state]) return null;
    const [title, text] = texts[scene.state];
    return h("section", { class: "panel", "data-notice": "" }, h("h2", {}, title), h("p", { class: scene.state === "failed" ? "complaint" : undefined }, text),
      scene.state === "failed" && scene.log && h("a", { href: `/log/${scene.id}/${scene.number}`, target: "_blank" }, "What the program printed"));
  };
  const slider = (label, { min, max, step, value, hint }) => {
    const output = h("output", {}, String(value)), input = h("input", { type: "range", min, max, step, value, oninput: () => { output.value = input.value; } });
    return { root: h("div", { class: "field" }, h("label", {}, output, label, input), hint && h("div", { class: "hint" }, hint)), input };
  };
  const styleFields = (settings) => {
    const chosen = new Set(settings.images), texts = h("div", { class: "texts" }), grid = h("div", { class: "paintings" });
    const mixed = h("input", { type: "checkbox", checked: settings.mix !== null }), mix = slider("From the first style to the second", { min: 0, max: 1, step: 0.05, value: settings.mix ?? 0.5 });
    const mixture = h("div", { class: "field" }, h("label", { class: "row" }, mixed, "Mix the two styles into one"), mix.root);
    const values = () => [...texts.querySelectorAll("input")].map((input) => input.value.trim()).filter(Boolean);
    const changed = () => { mixture.hidden = values().length + chosen.size !== 2; mix.root.hidden = !mixed.checked; };
    mixed.addEventListener("change", changed);
    const addText = (value = "", focus = false) => {
      const input = h("input", { type: "text", value, placeholder: TEXTS[0], "aria-label": "A style in words", list: "texts", maxLength: 2000, oninput: changed });
      const row = h("div", { class: "row" }, input, h("button", { type: "button", class: "quiet", "aria-label": "Remove this text", onclick: () => { if (texts.children.length > 1) row.remove(); else input.value = ""; changed(); } }, "×"));
      texts.append(row);
      if (focus) input.focus();
    };
    (settings.texts.length ? settings.texts : [""]).forEach((text) => addText(text));
    const tile = (value, title, address) => {
      const box = h("input", { type: "checkbox", value, checked: chosen.has(value), onchange: () => { if (box.checked) chosen.add(value); else chosen.delete(value); changed(); } });
      return h("label", { class: "choice" }, box, picture(address), h("span", {}, title));
    };
    const more = h("label", { class: "choice add file" }, h("input", { type: "file", accept: choices.suffixes.photographs.join(","), multiple: true, onchange: async (event) => { for (const file of [...event.target.files]) choose(await addPicture(file)); } }), "Add a picture");
    let shown = null;
    const draw = () => {
      const now = [...chosen].join() + state.pictures.join();
      if (now === shown) return;
      shown = now;
      fill(grid, choices.paintings.map(({ name, title }) => tile(`example:${name}`, title.replace(/\s*\(.*/, ""), `/painting/${name}`)),
        state.pictures.map((name) => tile(name, name.replace(/(-[0-9a-f]{8})?\.png$/, ""), `/picture/${encodeURIComponent(name)}`)), more);
    };
    const choose = (name) => { if (name) { chosen.add(name); shown = null; draw(); changed(); } };
    draw();
    changed();
    const root = h("fieldset", { "data-styles": "" }, h("legend", {}, "Styles"),
      h("p", { class: "soft" }, "In words, like a painting, or like a picture of yours. Each becomes a version of the scene; without any style it is kept, too."),
      h("datalist", { id: "texts" }, TEXTS.map((text) => h("option", { value: text }))), texts,
      h("p", {}, h("button", { type: "button", class: "quiet", onclick: () => addText("", true) }, "+ Another text")), grid, mixture);
    const read = () => ({ texts: values(), images: [...chosen], mix: !mixture.hidden && mixed.checked ? Number(mix.input.value) : null });
    return { root, read, choose, update: draw };
  };
  const form = (scene) => {
    const settings = scene.settings, styles = styleFields(settings.texts.length + settings.images.length || scene.number ? settings : { ...settings, images: [`example:${choices.paintings[0].name}`] });
    const taken = (file) => attempt(async () => { await post(`/scenes/${scene.id}/remove`, { name: file }); await refresh(); });
    const pictures = strip(scene, { remove: taken, draw: (file) => { editor ??= window.maskEditor({ h, drawing, save: keepMask }); editor(state.scene, file); } });
    const masked = h("select", { id: "masked" }, [["ignored", "hides the scene"], ["empty", "is empty space"]].map(([value, text]) => h("option", { value, selected: value === settings.masked }, text)));
    const unmask = h("button", { type: "button", class: "quiet", onclick: () => attempt(async () => {
      if (await question({ title: "Remove all masks?", detail: "What is marked in the photographs of this scene is forgotten.", yes: "Remove" })) { await post(`/scenes/${scene.id}/unmask`); await refresh(); }
    }) }, "Remove all masks");
    const maskHint = h("p", { class: "hint" }), masks = h("div", { class: "row", hidden: true }, h("label", { class: "tight" }, "What is marked ", masked), unmask);
    const quality = h("div", { class: "segments", role: "radiogroup", "aria-label": "Quality" }, choices.qualities.map((name) => h("label", {}, h("input", { type: "radio", name: "quality", value: name, checked: name === settings.quality }), capital(name))));
    const strength = slider("Strength", { min: 0, max: 1, step: 0.05, value: settings.strength, hint: "0 is the scene as it was photographed." });
    const preserve = slider("Keep the scene's colours", { min: 0, max: 1, step: 0.05, value: settings.preserve_color, hint: "1 paints the style's strokes in the scene's hues." });
    const scale = slider("Size of strokes", { min: 0.25, max: 4, step: 0.25, value: settings.scale, hint: "2 paints them twice as large." });
    const method = h("select", { id: "method" }, choices.methods.map((name) => h("option", { value: name, selected: name === settings.method }, name === "branch" ? "branch (single pass)" : name)));
    const more = h("textarea", { id: "more", rows: 2, value: settings.more, spellcheck: false, placeholder: "views.take=24 --mask sphere:0,0,1.5,0.5" });
    const uploading = h("div", { hidden: true }, h("p", { class: "hint" }), h("progress", { max: 1, "aria-label": "Upload" }));
    const complaint = h("p", { class: "complaint", role: "alert", hidden: true });
    const start = h("button", { type: "submit", class: "main" }, scene.result ? "Make it again" : "Make the scene");
    const top = h("h1", { tabIndex: -1 }), lead = h("p", { class: "lead" }), told = h("div");
    const adding = picker("Add photographs", { accept: choices.suffixes.photographs, on: (files) => add(files, scene.id) });
    const addingMasks = picker("Add masks", { accept: choices.suffixes.photographs, on: (files) => addMasks(files, scene.id) });
    const simple = [settings.strength, settings.preserve_color, settings.scale, settings.method, settings.more].join() === "1,0,1,branch,";
    const submit = async (event) => {
      event.preventDefault();
      complaint.hidden = true;
      start.disabled = true;
      const sent = { ...styles.read(), quality: quality.querySelector(":checked")?.value ?? settings.quality, strength: Number(strength.input.value), preserve_color: Number(preserve.input.value), scale: Number(scale.input.value), masked: masked.value, method: method.value, more: more.value };
      try {
        await post(`/scenes/${scene.id}/run`, sent);
        go(`#/${scene.id}`);
        await refresh();
      } catch (error) {
        complaint.textContent = error.message;
        complaint.hidden = false;
        complaint.scrollIntoView({ block: "nearest" });
      }
      update();
    };
    const root = h("form", { onsubmit: submit, noValidate: true },
      h("div", { class: "row between" }, top, h("div", { class: "row" }, scene.result && h("a", { class: "button", href: `#/${scene.id}` }, "Back to the scene"), h("button", { type: "button", class: "quiet", onclick: () => rename(state.scene) }, "Rename"), h("button", { type: "button", class: "quiet", onclick: () => remove(state.scene) }, "Delete"))),
      lead, told,
      h("section", { "data-masks": "" }, pictures.list, uploading, maskHint, masks, h("div", { class: "row" }, adding, addingMasks)),
      styles.root,
      scene.kind !== "splat" && h("fieldset", {}, h("legend", {}, "Quality"), quality, h("p", { class: "hint" }, "A dozen photographs take a minute or two at “good” on a laptop's processor, a little less at “draft”, and several times as long at “best”.")),
      h("details", { open: !simple }, h("summary", {}, "More settings"),
        h("div", { class: "fields" }, strength.root, preserve.root, scale.root, h("div", { class: "field" }, h("label", { htmlFor: "method" }, "Method"), method, h("div", { class: "hint" }, "Others optimise one scene for minutes; brush lays strokes over it."))),
        h("div", { class: "field" }, h("label", { htmlFor: "more" }, "All options"), more, h("div", { class: "hint" }, "Further words of anystyle stylize: flags, and key=value for every component."))),
      complaint, h("div", { class: "row submit" }, start));
    let noticed = "";
    const update = () => {
      const now = state.scene, upload = uploads.get(scene.id);
      if (!now) return;
      if (top.textContent !== now.title) top.textContent = now.title;
      const words = now.kind ? `${count(now.count, now.kind)}${now.kind === "photographs" && now.count < 3 ? ": at least three that overlap are needed, better eight or more" : ""}.` : upload ? "" : "Nothing was added yet.";
      if (now.kind === "film" || now.kind === "splat") lead.textContent = now.kind === "film" ? "A film; its sharpest frames are taken." : "A splat that is there already: it keeps its shape and takes other colours.";
      else lead.textContent = words;
      adding.hidden = !(now.kind === "photographs" || !now.kind);
      const marked = Object.keys(now.masks).length;
      maskHint.hidden = addingMasks.hidden = !["photographs", "example"].includes(now.kind);
      masks.hidden = !marked;
      maskHint.textContent = marked ? `${marked} of ${now.count} have masks. What hides the scene, such as people and cars, is not learnt: other photographs show what is behind. Empty space is what surrounds an object that is cut out.` : "People, cars, the sky? Click a photograph and mark what should not be in the scene, or add masks named as the photographs: white counts, black does not.";
      pictures.update(now);
      styles.update();
      const key = [now.state, now.error, now.number].join();
      if (key !== noticed) { noticed = key; fill(told, notice(now, (words) => { more.value = words; more.closest("details").open = true; more.focus(); })); }
      uploading.hidden = !upload;
      start.disabled = Boolean(upload) || !now.kind;
      if (upload) {
        const [text, bar] = uploading.children;
        text.textContent = upload.sent < upload.bytes ? `Adding ${upload.done + 1} of ${upload.files} …` : "Looking at what was added …";
        bar.value = upload.sent / Math.max(1, upload.bytes);
        say(`Adding ${upload.files} files.`);
      } else if (now.kind) say(`${count(now.count, now.kind)} added.`);
    };
    return { name: "form", title: scene.title, root, update, choose: styles.choose };
  };

  // A scene that is being made
  const work = (scene) => {
    const steps = h("ol", { class: "steps" }), bar = h("progress", { max: 1, value: 0, "aria-label": "Progress" }), sentence = h("p", { class: "sentence" });
    const notes = h("ul", { class: "notes" }), since = h("p", { class: "hint" }), pictures = strip(scene), top = h("h1", { tabIndex: -1 });
    const cancel = h("button", { type: "button", onclick: () => attempt(async () => { cancel.disabled = true; sentence.textContent = "Ending …"; await post(`/scenes/${scene.id}/cancel`); await refresh(); }).then(() => { cancel.disabled = false; }) }, "Cancel");
    const root = h("div", { class: "working" }, h("div", { class: "row between" }, top, cancel),
      h("section", { class: "panel" }, steps, sentence, bar, since, notes),
      h("section", {}, pictures.list),
      h("p", { class: "hint" }, "This page may be closed: the work goes on as long as the program runs, and the page shows it again."));
    const update = () => {
      const now = state.scene, progress = now?.progress;
      if (!now || cancel.disabled) return;
      if (top.textContent !== now.title) top.textContent = now.title;
      const step = progress?.step ?? -1;
      fill(steps, now.steps.map((name, index) => h("li", { class: index < step ? "done" : index === step ? "now" : undefined, "aria-current": index === step ? "step" : undefined }, name)));
      sentence.textContent = progress ? progress.sentence : now.before ? `Waits for ${now.before === 1 ? "another scene" : `${now.before} other scenes`}.` : "Starting.";
      bar.value = progress?.done ?? 0;
      since.textContent = progress ? `${lasted(Math.max(0, Date.now() / 1000 - progress.started))} so far, ${Math.round(100 * progress.done)} % done` : "";
      fill(notes, (progress?.notes ?? []).map((note) => h("li", {}, capital(note))));
      say(progress ? `${now.steps[step] ?? ""}, ${Math.round(10 * progress.done) * 10} percent done.` : sentence.textContent);
    };
    return { name: "work", title: scene.title, root, update };
  };

  // A scene that is made
  const made = (scene) => {
    const result = scene.result, base = (kind, ...rest) => `/${[kind, scene.id, result.number, ...rest].join("/")}`;
    const frame = h("iframe", { title: `The scene ${scene.title} in its styles`, allow: "fullscreen *; clipboard-write *" }), top = h("h1", { tabIndex: -1 }), notices = h("div");
    if (result.page) frame.src = base("page");
    const live = h("button", { type: "button", disabled: !choices.live, title: choices.live ? undefined : 'Needs: pip install "anystyle[viewer]"', onclick: () => attempt(async () => { await post(`/scenes/${scene.id}/live`); wanted = true; await refresh(); }) }, "Try further styles live");
    const tab = h("a", { class: "button", href: base("page"), target: "_blank", rel: "noopener" }, "Open in a tab of its own");
    const liveHint = h("p", { class: "hint" }, choices.live ? "Drag to look around. Live, the scene takes any text or picture at once, mixed, in places, and along a path for a film." : 'Drag to look around. To try styles live: pip install "anystyle[viewer]"');
    const style = h("select", { "aria-label": "Style" }), format = h("select", { "aria-label": "Format", onchange: () => offer() });
    const saved = h("p", { class: "hint", role: "status" });
    const download = h("button", { type: "button", class: "main", onclick: () => attempt(async () => {
      download.disabled = true;
      saved.textContent = "Writing the file …";
      const file = await post(`/scenes/${scene.id}/export`, { format: format.value, style: style.value }).finally(() => { download.disabled = false; saved.textContent = ""; });
      saved.textContent = `${file.name}, ${megabytes(file.bytes)}`;
      h("a", { href: `${file.address}?name=${encodeURIComponent(file.name)}`, download: file.name }).click();
    }) }, "Download");
    const about = { html: "a page to look at, with all styles", ply: "3DGS viewers", zip: "everything", glb: "glTF", spz: "small", sog: "small", splat: "web viewers", ksplat: "GaussianSplats3D", usdz: "OpenUSD" };
    const offer = () => {
      const many = choices.formats[format.value], before = style.value;
      fill(style, many && result.styles.length > 1 && h("option", { value: "all" }, "all styles"), result.styles.map((title, index) => h("option", { value: String(index) }, title)), format.value !== "zip" && h("option", { value: "unstyled" }, "unstyled"));
      if ([...style.options].some((option) => option.value === before)) style.value = before;
    };
    fill(format, Object.keys(choices.formats).sort((a, b) => (b === "html") - (a === "html") || (b === "ply") - (a === "ply")).map((name) => h("option", { value: name }, about[name] ? `${name} (${about[name]})` : name)));
    offer();
    const copied = h("button", { type: "button", onclick: async () => { try { await navigator.clipboard.writeText(result.command); copied.textContent = "Copied"; } catch { copied.textContent = "Select it by hand"; } } }, "Copy");
    const fit = result.reconstruction;
    const facts = [
      fit.registered > 0 && scene.kind !== "splat" && ["Photographs used", scene.kind === "photographs" ? `${fit.registered} of ${scene.count}` : String(fit.registered)],
      ["Gaussians", result.gaussians.toLocaleString()],
      fit.heldout_psnr && ["Likeness to photographs left aside", `${fit.heldout_psnr.toFixed(1)} dB PSNR${fit.heldout_ssim ? `, SSIM ${fit.heldout_ssim.toFixed(2)}` : ""}`],
      fit.trust && ["Cameras", { good: "found, and confirmed by a second method", doubtful: "doubtful" }[fit.trust] ?? fit.trust],
      scene.state === "done" && ["Time", lasted(scene.seconds)]].filter(Boolean);
    const doubts = [...new Set([...fit.reasons, ...(scene.state === "done" ? scene.notes : []).map((note) => note.replace(/^cameras: /, ""))])];
    const root = h("div", {},
      h("div", { class: "row between" }, top, h("div", { class: "row" }, h("a", { class: "button main", href: `#/${scene.id}/settings` }, "Styles and settings"), h("button", { type: "button", class: "quiet", onclick: () => rename(state.scene) }, "Rename"), h("button", { type: "button", class: "quiet", onclick: () => remove(state.scene) }, "Delete"))),
      notices, h("div", { class: "stage", hidden: !result.page }, frame),
      h("div", { class: "row toolbar" }, live, tab, liveHint),
      doubts.length > 0 && h("section", { class: "panel", "data-doubts": "" }, h("h2", {}, fit.trust === "doubtful" ? "The cameras are doubtful" : "Worth knowing"), h("ul", { class: "reasons" }, doubts.map((reason) => h("li", {}, reason))),
        fit.trust === "doubtful" && h("div", { class: "advice" }, advice())),
      h("section", { "aria-labelledby": "styles-made" }, h("h2", { id: "styles-made" }, "Styles"), h("ul", { class: "styles" }, result.styles.map((title, index) => h("li", {}, picture(base("style", index), `The scene in the style ${title}`), h("b", {}, title),
        h("div", { class: "row" }, h("a", { href: base("film", index), target: "_blank" }, "Film"), h("a", { href: base("sheet", index), target: "_blank" }, "Sheet")))))),
      h("div", { class: "columns" },
        h("section", { class: "panel", "aria-labelledby": "download" }, h("h2", { id: "download" }, "Download"), h("div", { class: "fields" }, h("div", { class: "field" }, h("span", { class: "label" }, "Format"), format), h("div", { class: "field" }, h("span", { class: "label" }, "Style"), style)), h("div", { class: "row" }, download, saved),
          h("h2", { class: "below" }, "As a command line"), h("pre", {}, result.command), copied),
        h("section", { class: "panel" }, h("h2", {}, "How it was made"), h("dl", {}, facts.map(([name, value]) => [h("dt", {}, name), h("dd", {}, value)])),
          result.licenses.length > 0 && h("details", {}, h("summary", {}, "Licences of the networks"), h("ul", { class: "reasons hint" }, result.licenses.map((text) => h("li", {}, text)))))),
      scene.thumbnails.length > 0 && h("section", { class: "below" }, h("h2", {}, scene.kind === "film" ? "The film" : "The photographs"), strip(scene).list));
    let wanted = false, shown = frame.src, looked = "";
    const told = (event) => { if (event.source === frame.contentWindow && typeof event.data?.style === "string") looked = event.data.style; };
    const update = () => {
      const now = state.scene;
      if (!now) return;
      if (top.textContent !== now.title) top.textContent = now.title;
      fill(notices, now.state !== "done" ? notice(now) : null);
      if (now.live?.error && wanted) { wanted = false; complain(capital(now.live.error)); }
      live.textContent = wanted && !now.live?.address ? "Starting the viewer …" : now.live?.address && shown === now.live.address ? "Live" : "Try further styles live";
      live.disabled = !choices.live || wanted || shown === now.live?.address;
      if (wanted && now.live?.address) {
        wanted = false;
        frame.parentElement.hidden = false;
        frame.parentElement.classList.add("live");
        shown = now.live.address;
        frame.src = tab.href = `${shown}#${new URLSearchParams({ style: looked })}`;
        say("The live viewer is open.");
        update();
      } else if (!now.live && shown.startsWith("http://127") && shown !== location.href && !shown.startsWith(location.origin)) {
        shown = frame.src = result.page ? new URL(base("page"), location).href : "about:blank"; // nobody looked, so it has ended
        tab.href = base("page");
        frame.parentElement.classList.remove("live");
      }
    };
    return { name: "made", title: scene.title, root, update, told };
  };
  const gone = () => ({ name: "gone", title: "anystyle", root: h("div", {}, heading("This scene is not there any more"), h("p", {}, h("a", { href: "#/" }, "All scenes"))), update: () => {} });

  const keyOf = ({ scene, part }) => {
    const now = state.scene;
    if (!scene) return "home";
    if (!now) return "gone";
    const phase = ACTIVE.includes(now.state) ? "work" : now.result && part !== "settings" ? "made" : "form";
    return [phase, scene, phase === "made" ? now.result.number : ""].join();
  };
  const show = () => {
    const key = keyOf(place());
    if (view?.key !== key) {
      const first = view === null, before = view?.name;
      view = { ...{ home, gone, work: () => work(state.scene), made: () => made(state.scene), form: () => form(state.scene) }[key.split(",")[0]](), key };
      fill(main, view.root);
      view.update();
      if (!first) {
        scrollTo(0, 0);
        main.querySelector("h1")?.focus({ preventScroll: true });
        if (before === "work") say(view.name === "made" ? "The scene is ready." : "The work has ended.");
      }
    } else view.update();
    document.title = view.name === "home" ? "anystyle" : `${state.scene?.title ?? ""} · anystyle`;
    const running = state.scenes.find((scene) => scene.state === "running" && scene.id !== place().scene);
    byId("busy").hidden = !running;
    if (running) fill(byId("busy"), "Being made: ", h("a", { href: `#/${running.id}` }, running.title));
  };
  let asked = 0;
  const refresh = async () => {
    clearTimeout(timer);
    const number = (asked += 1), { scene } = place();
    try {
      const answer = await fetch(`/state?scene=${scene}`);
      if (!answer.ok) throw new Error();
      const now = await answer.json();
      if (lost) complain("");
      lost = false;
      if (number === asked && place().scene === scene) {
        state = now;
        show();
      }
    } catch (error) {
      if (error instanceof TypeError && error.message !== "Failed to fetch" && !/NetworkError|Load failed/.test(error.message)) throw error;
      lost = true;
      complain("The program does not answer. If it has ended, start it again: anystyle view");
    }
    if (number !== asked) return;
    clearTimeout(timer);
    timer = setTimeout(refresh, document.hidden ? 10000 : 1000);
  };
  addEventListener("hashchange", refresh);
  document.addEventListener("visibilitychange", () => { if (!document.hidden && choices) refresh(); });
  (async () => {
    choices = await (await fetch("/choices")).json();
    await refresh();
  })();
})();
