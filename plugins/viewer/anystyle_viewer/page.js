// What viser's page lacks: pictures are dropped anywhere, a row of styles is chosen from, a line parts before and after.
(() => {
  "use strict";
  const LARGEST = $largest;
  if (matchMedia("(prefers-color-scheme: dark)").matches) window.__VISER_EMBED_CONFIG__ = { darkMode: true };

  const element = (id, role) => {
    const made = document.createElement("div");
    made.id = id;
    made.hidden = true;
    if (role) made.setAttribute("role", role);
    return made;
  };
  const ground = element("anystyle-drop"), note = element("anystyle-note", "status"), line = element("anystyle-line");
  ground.textContent = "Drop a picture: the scene is painted in its style";
  addEventListener("DOMContentLoaded", () => document.body.append(ground, note, line));

  const say = (text) => {
    note.textContent = text;
    note.hidden = !text;
  };
  const send = async (path, body) => {
    say("");
    try {
      const answer = await fetch(path, { method: "POST", body });
      if (!answer.ok) say((await answer.text()).trim());
    } catch {
      say("The viewer does not answer.");
    }
  };

  // The style that was looked at where a link led here; viser would take the fragment for a part of its server's address.
  const opened = new URLSearchParams(location.hash.slice(1)).get("style");
  history.replaceState(null, "", location.pathname + location.search);
  if (opened) send("/saved", opened);

  const holdsFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  let ends;
  const over = (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    ground.hidden = false;
    // A drag that is given up ends without a word; one that goes on says so several times a second.
    clearTimeout(ends);
    ends = setTimeout(() => { ground.hidden = true; }, 1000);
  };
  addEventListener("dragenter", over, true);
  addEventListener("dragover", over, true);
  addEventListener("drop", async (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    ground.hidden = true;
    for (const file of event.dataTransfer.files) {
      if (file.size > LARGEST) say(`${file.name} has ${Math.ceil(file.size / 2 ** 20)} MB; at most ${LARGEST / 2 ** 20} are taken.`);
      else await send(`/picture?name=${encodeURIComponent(file.name)}`, file);
    }
  }, true);

  addEventListener("click", (event) => {
    const chosen = event.target.closest?.("[data-style]");
    if (chosen) send("/style", chosen.dataset.style);
  });

  // The line stands where the slider of this browser does; viser replaces the element that says so.
  new MutationObserver(() => {
    const split = document.querySelector("[data-split]")?.dataset.split, canvas = document.querySelector("canvas");
    line.hidden = !split || !canvas;
    if (line.hidden) return;
    const { left, width, top, height } = canvas.getBoundingClientRect();
    Object.assign(line.style, { left: `${left + split * width}px`, top: `${top}px`, height: `${height}px` });
  }).observe(document, { subtree: true, childList: true });
})();
