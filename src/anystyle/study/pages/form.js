"use strict";
(() => {
  const study = JSON.parse(document.getElementById("study").textContent);
  const main = document.getElementById("main");
  const notice = document.getElementById("notice");
  const COLUMNS = ["participant", "item", "question", "score", "ours_is", "expected", "comparison", "seconds", "time", "session", "revision", "comment"];
  let state = null; // {participant, session, place, answers: {item: {question: {...}}}, comment, outbox}
  let shownAt = 0;

  // ---- small tools
  const make = (tag, options = {}, ...children) => {
    const { text, ...rest } = options;
    const node = document.createElement(tag);
    if (text !== undefined) node.textContent = text;
    for (const [name, value] of Object.entries(rest)) {
      if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
      else if (value === true) node.setAttribute(name, "");
      else if (value !== false && value !== undefined) node.setAttribute(name, value);
    }
    node.append(...children);
    return node;
  };
  const show = (...nodes) => {
    main.replaceChildren(...nodes);
    window.scrollTo(0, 0);
    const heading = main.querySelector("h1");
    if (heading) heading.focus();
  };
  const warn = (text) => { notice.textContent = text; notice.hidden = !text; };
  const checksum = (text) => {
    let value = 2166136261;
    for (let place = 0; place < text.length; place++) value = Math.imul(value ^ text.charCodeAt(place), 16777619) >>> 0;
    return value;
  };

  // ---- what is kept in this browser
  const key = (participant) => `study:${study.id}:${participant}`;
  const keep = () => {
    try {
      localStorage.setItem(key(state.participant), JSON.stringify(state));
      localStorage.setItem(`study:${study.id}`, state.participant);
    } catch {
      warn("This browser does not keep answers: please do not close the page before you have saved them at the end.");
    }
  };
  const kept = (participant) => {
    try { return JSON.parse(localStorage.getItem(key(participant))); } catch { return null; }
  };
  const lastParticipant = () => {
    try { return localStorage.getItem(`study:${study.id}`) || ""; } catch { return ""; }
  };

  // ---- what is sent to the study's server, where the page comes from one
  let sending = false;
  const send = async () => {
    if (!study.server || sending || !state.outbox.length) return;
    sending = true;
    while (state.outbox.length) {
      try {
        const reply = await fetch("answers", {
          method: "POST",
          headers: { "Content-Type": "application/json" },
          body: JSON.stringify({ study: study.id, ...state.outbox[0] }),
        });
        if (reply.status >= 500 || reply.status === 429) throw new Error(String(reply.status));
        if (!reply.ok) warn(`The server did not accept an answer (${reply.status}); please tell the experimenter.`);
        state.outbox.shift();
        keep();
        if (reply.ok) warn("");
      } catch {
        warn("The server does not answer. Your answers are kept here and sent as soon as it does.");
        await new Promise((resolve) => setTimeout(resolve, 1000));
      }
    }
    sending = false;
    const saved = document.getElementById("saved");
    if (saved) saved.textContent = "All answers have reached the server.";
  };
  const fromServer = async (participant) => {
    if (!study.server) return null;
    try {
      const reply = await fetch(`state?participant=${encodeURIComponent(participant)}`);
      return reply.ok ? await reply.json() : null;
    } catch { return null; }
  };

  // ---- the order of things
  const entries = () => study.participants[state.participant].map((entry) => {
    const [id, first] = entry.split(":");
    return { id, item: study.items[id], check: study.checks[id], first: Number(first) };
  });
  const sides = (entry) => (entry.first ? [entry.item.pair[1], entry.item.pair[0]] : entry.item.pair);
  const oursIs = (entry) => (entry.item ? (checksum(study.id + sides(entry)[0]) >>> 8 & 1 ? "A" : "B") : "");
  const answered = (entry) => study.questions.every((question) => state.answers[entry.id]?.[question.name]);
  const firstOpen = (list) => { const place = list.findIndex((entry) => !answered(entry)); return place < 0 ? list.length : place; };

  const record = (entry, question, score) => {
    const before = state.answers[entry.id]?.[question.name];
    if (before && before.score === score) return;
    const answer = {
      score,
      seconds: Math.round((performance.now() - shownAt) / 100) / 10,
      time: new Date().toISOString(),
      revision: before ? before.revision + 1 : 1,
    };
    (state.answers[entry.id] ??= {})[question.name] = answer;
    state.outbox.push({ participant: state.participant, session: state.session, item: entry.id, question: question.name, ...answer });
    keep();
    send();
  };

  // ---- pages
  const progress = (value, total, text) => {
    const bar = document.getElementById("progress");
    bar.max = total;
    bar.value = value;
    document.getElementById("place").textContent = text;
  };

  const start = (error = "") => {
    progress(0, 1, "");
    const asked = new URLSearchParams(location.search).get("p") || decodeURIComponent(location.hash.slice(1)) || lastParticipant();
    const input = make("input", { type: "text", id: "code", value: asked, autocomplete: "off", autocapitalize: "characters", spellcheck: "false", "aria-describedby": "codeerror" });
    const begin = async (event) => {
      event.preventDefault();
      const wanted = input.value.trim().toUpperCase();
      const code = Object.keys(study.participants).find((name) => name.toUpperCase() === wanted);
      if (!code) {
        message.textContent = "This code is not known. Please check it.";
        input.focus();
        return;
      }
      const local = kept(code);
      const remote = local ? null : await fromServer(code);
      const session = [...crypto.getRandomValues(new Uint8Array(8))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
      state = local || { participant: code, session, answers: {}, comment: "", outbox: [], ...(remote || {}) };
      keep();
      send();
      page(firstOpen(entries()));
    };
    const message = make("p", { class: "error", id: "codeerror", role: "alert", text: error });
    show(make("div", { class: "words" },
      make("h1", { tabindex: "-1", text: study.title }),
      ...study.instructions.split(/\n\s*\n/).map((text) => make("p", { text })),
      make("form", { onsubmit: begin },
        make("label", { for: "code", text: "Your participant code" }), input, message,
        make("div", { class: "buttons" }, make("button", { class: "main", id: "start", text: "Start or go on" })))));
  };

  const picture = (name, caption, alt) => make("figure", {},
    make("figcaption", { text: caption }),
    make("img", { src: study.pictures[name], alt, draggable: "false" }));

  const judged = (entry) => {
    const [a, b] = sides(entry);
    const pair = make("div", { class: "pair", id: "pair" }, picture(a, "A", "Picture A"), picture(b, "B", "Picture B"));
    const shape = (img) => pair.style.setProperty("--shape", img.naturalWidth / img.naturalHeight);
    const image = pair.querySelector("img");
    if (image.complete && image.naturalWidth) shape(image);
    image.addEventListener("load", () => shape(image));
    const reference = entry.item.reference
      ? picture(entry.item.reference, "Style", "The style to match")
      : make("figure", {}, make("figcaption", { text: "Style" }), make("p", { class: "quote", text: entry.item.text }));
    const enlarge = make("button", { type: "button", "aria-pressed": "false", text: "Enlarge A and B" });
    enlarge.addEventListener("click", () => {
      const large = pair.classList.toggle("large");
      enlarge.setAttribute("aria-pressed", String(large));
      enlarge.textContent = large ? "A and B side by side" : "Enlarge A and B";
    });
    return [
      make("div", { class: "set" },
        make("div", { class: "given" }, picture(entry.item.content, "Photograph", "The photograph"), reference),
        make("div", {}, pair)),
      enlarge,
    ];
  };

  const page = (place) => {
    const list = entries();
    if (place >= list.length) return finish(list);
    const entry = list[place];
    state.place = place;
    progress(place, list.length, `${place + 1} of ${list.length}`);
    const next = make("button", { class: "main", type: "button", id: "next", text: "Next", disabled: !answered(entry), onclick: () => page(place + 1) });
    const back = make("button", { type: "button", id: "back", text: "Back", disabled: place === 0, onclick: () => page(place - 1) });
    const fields = study.questions.map((question) => {
      const field = make("fieldset", { "data-question": question.name }, make("legend", { text: question.text }));
      study.labels.forEach((label, step) => {
        const score = study.low + step;
        const radio = make("input", { type: "radio", name: question.name, value: score });
        radio.checked = state.answers[entry.id]?.[question.name]?.score === score;
        radio.addEventListener("change", () => {
          record(entry, question, score);
          next.disabled = !answered(entry);
        });
        field.append(make("label", { class: "answer" }, radio, make("b", { text: String(score), "aria-hidden": "true" }), make("span", { text: label })));
      });
      return field;
    });
    let extra = [];
    let content;
    if (entry.item) {
      const [set, enlarge] = judged(entry);
      content = [make("h1", { tabindex: "-1", text: "Compare A and B" }), set];
      extra = [enlarge];
    } else {
      const label = study.labels[entry.check.expected - study.low];
      content = [make("div", { class: "words" },
        make("h1", { tabindex: "-1", text: "A short check" }),
        make("p", { text: `To show that you are reading, please answer “${label}” to every question on this page.` }))];
    }
    show(...content,
      make("div", { class: "questions" }, ...fields),
      make("div", { class: "buttons" }, back, next, ...extra,
        make("span", { class: "hint keys", text: `Keys: ${study.low} to ${study.low + study.labels.length - 1} answer, Enter goes on, Backspace goes back.` })));
    shownAt = performance.now();
  };

  const keys = (event) => {
    if (!state || event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input[type=text], textarea")) return;
    const fields = [...main.querySelectorAll("fieldset")];
    if (!fields.length) return;
    const score = Number(event.key);
    if (event.key.length === 1 && score >= study.low && score < study.low + study.labels.length) {
      const focused = event.target.closest("fieldset");
      const field = focused || fields.find((one) => !one.querySelector("input:checked")) || fields[fields.length - 1];
      const radio = [...field.querySelectorAll("input")].find((one) => Number(one.value) === score);
      radio.checked = true;
      radio.dispatchEvent(new Event("change"));
      const open = fields.find((one) => !one.querySelector("input:checked"));
      if (open) open.querySelector("input").focus();
      else document.getElementById("next").focus();
      event.preventDefault();
    } else if (event.key === "Enter" && !event.target.matches("button")) {
      document.getElementById("next").click();
      event.preventDefault();
    } else if (event.key === "Backspace") {
      document.getElementById("back").click();
      event.preventDefault();
    }
  };
  document.addEventListener("keydown", keys);

  // ---- the end: everything as CSV and JSON
  const rows = () => {
    const found = entries().flatMap((entry) => study.questions.flatMap((question) => {
      const answer = state.answers[entry.id]?.[question.name];
      return answer ? [{
        participant: state.participant, item: entry.id, question: question.name, score: answer.score, ours_is: oursIs(entry),
        expected: entry.check ? entry.check.expected : "", comparison: entry.item?.comparison || "", seconds: answer.seconds,
        time: answer.time, session: state.session, revision: answer.revision, comment: "",
      }] : [];
    }));
    if (found.length) found[0].comment = state.comment;
    return found;
  };
  const cell = (value) => {
    let text = String(value);
    if (typeof value === "string" && /^[=+\-@\t\r]/.test(text)) text = `'${text}`; // no spreadsheet takes it for a formula
    return /[",;\t\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  const download = (name, type, text) => {
    const link = make("a", { href: URL.createObjectURL(new Blob([text], { type })), download: name });
    document.body.append(link);
    link.click();
    link.remove();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  };

  const finish = (list) => {
    progress(list.length, list.length, "Done");
    const comment = make("textarea", { id: "comment", rows: "4" });
    comment.value = state.comment;
    const store = () => {
      if (state.comment === comment.value) return;
      state.comment = comment.value;
      state.outbox.push({ participant: state.participant, session: state.session, comment: state.comment, time: new Date().toISOString() });
      keep();
      send();
    };
    comment.addEventListener("change", store);
    const name = `answers-${state.participant}`;
    const csv = () => { store(); download(`${name}.csv`, "text/csv", [COLUMNS, ...rows().map((row) => COLUMNS.map((column) => row[column]))].map((row) => row.map(cell).join(",")).join("\r\n") + "\r\n"); };
    const json = () => { store(); download(`${name}.json`, "application/json", JSON.stringify({ study: study.id, responses: rows() }, null, 1)); };
    const saved = study.server
      ? make("p", { id: "saved", role: "status", text: state.outbox.length ? "Your answers are being sent …" : "All answers have reached the server." })
      : make("p", { text: "Please save your answers with one of the buttons and send the file to the experimenter." });
    show(make("div", { class: "words" },
      make("h1", { tabindex: "-1", text: "Thank you" }), saved,
      make("label", { for: "comment", text: "Anything you would like to say? (optional)" }), comment,
      make("div", { class: "buttons" },
        make("button", { class: "main", type: "button", id: "csv", text: "Save answers as CSV", onclick: csv }),
        make("button", { type: "button", id: "json", text: "Save as JSON", onclick: json }),
        make("button", { type: "button", id: "back", text: "Back to the sets", onclick: () => page(list.length - 1) }))));
    send();
  };

  start();
})();
