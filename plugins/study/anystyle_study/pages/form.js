"use strict";
(() => {
  const study = JSON.parse(document.getElementById("study").textContent);
  const main = document.getElementById("main");
  const notice = document.getElementById("notice");
  let state = null; // {participant, answers: {key: {...}}, facts: {name: value}}
  let sets = [];
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
    node.append(...children.filter(Boolean));
    return node;
  };
  const words = (text) => text.trim().split(/\n\s*\n/).map((paragraph) => make("p", { text: paragraph }));
  const warn = (text) => { notice.textContent = text; notice.hidden = !text; };
  const show = (value, total, place, ...nodes) => {
    Object.assign(document.getElementById("progress"), { max: total, value });
    document.getElementById("place").textContent = place;
    main.replaceChildren(...nodes);
    window.scrollTo(0, 0);
    main.querySelector("h1").focus();
  };
  const heading = (text) => make("h1", { tabindex: "-1", text });
  const button = (id, text, onclick, options = {}) => make("button", { type: "button", id, text, onclick, ...options });

  // ---- what is kept in this browser
  const key = (participant) => `study:${study.id}:${participant}`;
  const keep = () => {
    try {
      localStorage.setItem(key(state.participant), JSON.stringify(state));
      localStorage.setItem(`study:${study.id}`, state.participant);
    } catch {
      warn("This browser keeps nothing: please do not close or reload the page before the end.");
    }
  };
  const kept = (name) => {
    try { return localStorage.getItem(name); } catch { return null; }
  };

  // ---- beginning, and going on
  const begin = (participant) => {
    sets = study.people[participant];
    if (!sets) return "This code is not known. Please check it.";
    state = JSON.parse(kept(key(participant)) || "null") || { participant, answers: {}, facts: {} };
    keep();
    return "";
  };

  const welcome = () => {
    const code = decodeURIComponent(location.hash.slice(1)) || kept(`study:${study.id}`) || "";
    const input = make("input", { type: "text", id: "code", value: code, autocomplete: "off", autocapitalize: "characters", spellcheck: "false", "aria-describedby": "codeerror" });
    const message = make("p", { class: "error", id: "codeerror", role: "alert" });
    const submit = (event) => {
      event.preventDefault();
      message.textContent = begin(input.value.trim().toUpperCase());
      return message.textContent ? input.focus() : consent();
    };
    show(0, 1, "", make("div", { class: "words" }, heading(study.title), ...words(study.instructions),
      make("form", { onsubmit: submit }, make("label", { for: "code", text: "Your participant code" }), input, message,
        make("div", { class: "buttons" }, make("button", { class: "main", id: "start", text: "Start or go on" })))));
  };

  const consent = () => {
    if (!study.consent || state.facts.consent) return person();
    const box = make("input", { type: "checkbox", id: "agree", onchange: () => { next.disabled = !box.checked; } });
    const next = button("next", "Next", () => {
      state.facts.consent = new Date().toISOString();
      keep();
      person();
    }, { class: "main", disabled: true });
    return show(0, 1, "", make("div", { class: "words" }, heading("Your consent"), ...words(study.consent),
      make("label", { class: "agree" }, box, make("span", { text: "I have read this, and agree to take part." })),
      make("div", { class: "buttons" }, next)));
  };

  const person = () => {
    if (!study.demographics.length || "asked" in state || Object.keys(state.answers).length) return page(firstOpen());
    const fields = study.demographics.map(({ name, text, choices }) => {
      const id = `person-${name}`;
      const field = choices.length
        ? make("select", { id }, ...["", ...choices].map((value) => make("option", { value, text: value || "Prefer not to say" })))
        : make("input", { type: "text", id, maxlength: "200", autocomplete: "off" });
      return [name, field, make("p", {}, make("label", { for: id, text }), field)];
    });
    const next = () => {
      state.asked = true;
      for (const [name, field] of fields) {
        if (field.value) state.facts[name] = field.value;
      }
      keep();
      page(firstOpen());
    };
    return show(0, 1, "", make("div", { class: "words" }, heading("About you"), make("p", { text: "Each answer is optional." }),
      ...fields.map((field) => field[2]), make("div", { class: "buttons" }, button("next", "Next", next, { class: "main" }))));
  };

  // ---- answers
  const asked = study.questions.flatMap((question) => (question.kind === "rating" ? ["A", "B"] : [""]).map((side) => ({ ...question, side })));
  const answer = (set, question) => state.answers[[set.id, question.name, question.side]];
  const answered = (set) => asked.every((question) => answer(set, question));
  const firstOpen = () => { const index = sets.findIndex((set) => !answered(set)); return index < 0 ? sets.length : index; };
  const record = (set, question, score) => {
    const before = answer(set, question);
    if (before && before.score === score) return;
    const seconds = Math.round((performance.now() - shownAt) / 10) / 100;
    const given = { score, seconds, time: new Date().toISOString(), revision: before ? before.revision + 1 : 1 };
    state.answers[[set.id, question.name, question.side]] = given;
    keep();
  };

  // ---- pictures: every file is fetched once, whole, before it is shown
  const cache = new Map();
  const load = (name) => {
    if (!cache.has(name)) {
      const loading = (async () => {
        const reply = await fetch(study.pictures[name]);
        if (!reply.ok) throw new Error(String(reply.status));
        const url = URL.createObjectURL(await reply.blob());
        if (!name.endsWith(".mp4")) await Object.assign(new Image(), { src: url }).decode();
        return url;
      })();
      loading.catch(() => cache.delete(name));
      cache.set(name, loading);
    }
    return cache.get(name);
  };
  const files = (set) => [...set.A, ...set.B, ...set.content, set.reference].filter(Boolean);
  const element = async (name, alt) => {
    const src = await load(name);
    if (!name.endsWith(".mp4")) return make("img", { src, alt, draggable: "false" });
    const video = Object.assign(make("video", { "aria-label": alt, role: "img", playsinline: true, preload: "auto" }), { muted: true });
    await new Promise((resolve, reject) => {
      video.addEventListener("canplaythrough", resolve, { once: true });
      video.addEventListener("error", () => reject(new Error("unreadable")), { once: true });
      video.src = src;
    });
    return video;
  };
  const column = async (kind, title, alt, names) => {
    const label = (index) => (names.length > 1 ? `${alt}, view ${index + 1} of ${names.length}` : alt);
    return make("section", { class: `column ${kind}`, "aria-label": title }, make("h2", { text: title }),
      make("div", { class: "stack" }, ...(await Promise.all(names.map((name, index) => element(name, label(index)))))));
  };

  // What moves, moves together: videos begin again when the first has ended, flip-books turn by one clock.
  const player = (views, enlarge) => {
    const videos = [...views.querySelectorAll("video")];
    const stacks = study.show === "flipbook" ? [...views.querySelectorAll(".stack")].filter((stack) => stack.children.length > 1) : [];
    if (!videos.length && !stacks.length) return make("div", { class: "player" }, enlarge);
    const count = Math.max(1, ...stacks.map((stack) => stack.children.length));
    const slider = stacks.length ? make("input", { type: "range", min: "1", max: count, value: "1", "aria-label": "View" }) : null;
    let timer = 0;
    const turn = (index) => {
      if (slider) slider.value = index + 1;
      for (const stack of stacks) [...stack.children].forEach((view, other) => { view.hidden = other !== index % stack.children.length; });
    };
    const play = () => {
      toggle.textContent = "Pause";
      videos.forEach((video) => video.play().catch(() => {}));
      if (stacks.length) timer = setInterval(() => (views.isConnected ? turn(Number(slider.value) % count) : pause()), 1000 / study.frames_per_second);
    };
    const pause = () => {
      toggle.textContent = "Play";
      videos.forEach((video) => video.pause());
      clearInterval(timer);
    };
    const toggle = button("play", "Play", () => (toggle.textContent === "Play" ? play : pause)());
    if (slider) slider.addEventListener("input", () => { pause(); turn(Number(slider.value) - 1); });
    if (videos.length) videos[0].addEventListener("ended", () => { if (views.isConnected) { videos.forEach((video) => { video.currentTime = 0; }); play(); } });
    turn(0);
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play();
    return make("div", { class: "player" }, toggle, slider, enlarge);
  };

  const views = async (set) => {
    const columns = await Promise.all([
      column("content", set.content.length > 1 && study.show === "grid" ? "Photographs" : set.content[0].endsWith(".mp4") ? "Video" : "Photograph", "The original", set.content),
      column("method", "A", "A", set.A), column("method", "B", "B", set.B),
      set.reference ? column("reference", "Style", "The style to match", [set.reference])
        : make("section", { class: "column reference", "aria-label": "Style" }, make("h2", { text: "Style" }), make("p", { class: "quote", text: set.text })),
    ]);
    const [, a, , reference] = columns;
    const first = a.querySelector("img, video");
    const ratio = (first.naturalWidth || first.videoWidth) / (first.naturalHeight || first.videoHeight);
    const many = study.show === "grid" && set.A.length > 1;
    const node = make("div", { class: many ? "views many" : "views", style: `--ratio: ${ratio}; --rows: ${many ? set.A.length : 1}` }, ...columns);
    const enlarge = button("enlarge", "Enlarge", () => {
      const large = node.parentElement.classList.toggle("large");
      node.parentElement.classList.toggle("tall", many && !large);
      enlarge.textContent = large ? "Side by side" : "Enlarge";
    });
    node.append(player(node, enlarge));
    return node;
  };

  // ---- a set
  const scale = (set, question, changed) => {
    const text = question.text.replaceAll("{method}", question.side);
    const name = `${question.name}${question.side}`;
    return make("fieldset", { "data-question": name, disabled: true }, make("legend", { text }),
      make("div", { class: "scale" }, ...question.labels.map((label, step) => {
        const score = question.low + step;
        const radio = make("input", { type: "radio", name, value: score });
        radio.checked = answer(set, question)?.score === score;
        radio.addEventListener("change", () => { record(set, question, score); changed(); });
        return make("label", {}, radio, make("b", { text: score }), make("span", { text: label }));
      })));
  };

  const page = async (index) => {
    if (index >= sets.length) return finish();
    const set = sets[index];
    const next = button("next", "Next", () => page(index + 1), { class: "main", disabled: true });
    const back = button("back", "Back", () => page(index - 1), { disabled: index === 0 });
    const ready = () => node.dataset.loaded && answered(set);
    const fields = asked.map((question) => scale(set, question, () => { next.disabled = !ready(); }));
    const loading = make("div", { class: "loading", role: "status" }, make("p", { text: "Loading the pictures …" }));
    const numbers = study.questions[0].labels.map((_, step) => study.questions[0].low + step);
    const node = make("div", { class: "set" }, loading, make("div", { class: "questions" }, ...fields),
      make("div", { class: "buttons" }, back, next,
        make("span", { class: "hint keys", text: `Keys: ${numbers[0]} to ${numbers.at(-1)} answer, Enter next, Backspace back` })));
    show(index, sets.length, `${index + 1} of ${sets.length}`, heading("Compare A and B"), node);
    const reveal = async () => {
      try {
        const shown = await views(set);
        if (!node.isConnected) return;
        loading.replaceWith(shown);
        node.classList.toggle("tall", shown.classList.contains("many"));
        node.style.cssText = shown.style.cssText;
        node.dataset.loaded = "yes";
        fields.forEach((field) => { field.disabled = false; });
        next.disabled = !ready();
        // A set that is shown again goes on where its answers were given.
        shownAt = performance.now() - 1000 * Math.max(0, ...asked.map((question) => answer(set, question)?.seconds ?? 0));
        for (const name of sets[index + 1] ? files(sets[index + 1]) : []) load(name).catch(() => {});
      } catch {
        loading.replaceChildren(make("p", { text: "Some pictures could not be loaded. Please check your connection, and whether this browser blocks pictures. Your answers are safe." }),
          button("again", "Try again", () => { loading.replaceChildren(make("p", { text: "Loading the pictures …" })); reveal(); }));
      }
    };
    return reveal();
  };

  document.addEventListener("keydown", (event) => {
    if (!state || event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input:not([type=radio]), textarea, select")) return;
    const fields = [...main.querySelectorAll("fieldset:enabled")];
    if (!fields.length) return;
    const field = event.target.closest("fieldset") || fields.find((one) => !one.querySelector("input:checked")) || fields.at(-1);
    const radio = event.key.length === 1 && event.key !== " " && field.querySelector(`input[value="${CSS.escape(event.key)}"]`);
    if (radio) {
      radio.checked = true;
      radio.dispatchEvent(new Event("change"));
      const open = fields.find((one) => !one.querySelector("input:checked"));
      (open ? open.querySelector("input") : document.getElementById("next")).focus();
    } else if (event.key === "Enter" && !event.target.matches("button")) document.getElementById("next").click();
    else if (event.key === "Backspace") document.getElementById("back").click();
    else return;
    event.preventDefault();
  });

  // ---- the end
  const save = () => {
    const responses = sets.flatMap((set) => asked.filter((question) => answer(set, question)).map((question) => (
      { participant: state.participant, item: set.id, question: question.name, side: question.side, ...answer(set, question) })));
    const { comment = "", ...person } = state.facts;
    const text = JSON.stringify({ study: study.id, participant: state.participant, person, comment, responses }, null, 1);
    const link = make("a", { href: URL.createObjectURL(new Blob([text], { type: "application/json" })), download: `answers-${state.participant}.json` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  };

  const finish = () => {
    const comment = make("textarea", { id: "comment", rows: "4", maxlength: "10000" });
    comment.value = state.facts.comment || "";
    comment.addEventListener("change", () => {
      state.facts.comment = comment.value;
      keep();
    });
    const status = make("p", { id: "saved", role: "status", text: "Please save your answers and send the file to the experimenter." });
    const end = button("end", "Save answers", save, { class: "main" });
    show(1, 1, "Done", make("div", { class: "words" }, heading("Thank you"), status,
      make("label", { for: "comment", text: "Anything you would like to say? (optional)" }), comment,
      make("div", { class: "buttons" }, button("back", "Back to the sets", () => page(sets.length - 1)), end)));
  };

  welcome();
})();
