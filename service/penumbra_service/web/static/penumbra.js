// Makes the pages live: one stream of events a tab, closed while the tab is hidden. htmx fetches what changed.
"use strict";

(() => {
  const SHORTEST = 800; // milliseconds between two refreshes of one element
  const due = new Map(); // element's id, or the element where it has none -> timer and time of its last refresh
  let source = null;

  // Asks htmx to fetch `element` again, now or as soon as its last refresh is long enough ago. A refresh that is under
  // way may put another element with the same id in its place: then that one is meant.
  function refresh(element) {
    const key = element.id || element;
    const state = due.get(key) || { last: 0, timer: 0 };
    due.set(key, state);
    if (state.timer) return;
    const wait = Math.max(0, state.last + SHORTEST - Date.now());
    state.timer = setTimeout(() => {
      const present = element.isConnected ? element : element.id && document.getElementById(element.id);
      state.timer = 0;
      state.last = Date.now();
      if (present) htmx.trigger(present, "refresh");
      else due.delete(key);
    }, wait);
  }

  // Shows a newer picture once it has arrived, so that nothing flickers.
  function showPicture(frame, revision) {
    if (Number(frame.dataset.revision) >= revision) return;
    frame.dataset.revision = revision;
    const next = new Image();
    const old = frame.querySelector("img");
    next.alt = old ? old.alt : frame.dataset.kind;
    next.onload = () => {
      if (Number(frame.dataset.revision) === revision) frame.replaceChildren(next);
    };
    next.src = `/v1/jobs/${frame.dataset.picture}/${frame.dataset.kind}.png?r=${revision}`;
  }

  function onProgress(message) {
    const job = JSON.parse(message.data);
    const live = document.querySelectorAll(`[data-live="${CSS.escape(job.id)}"]`);
    const list = document.getElementById("cards");
    const card = document.getElementById(`job-${job.id}`);
    // a job that this list does not show yet, or whose new state gives it another place there
    if (list && card?.dataset.state !== job.state) refresh(list);
    live.forEach(refresh);
    document.querySelectorAll(`[data-picture="${CSS.escape(job.id)}"]`).forEach((frame) => {
      if (job.thumbnail_revision) showPicture(frame, job.thumbnail_revision);
    });
    document.querySelectorAll("[data-on-state]").forEach((element) => {
      if (element.dataset.onState === job.state) return;
      element.dataset.onState = job.state;
      refresh(element);
    });
  }

  function listen() {
    const address = document.body.dataset.events;
    if (!address || source || document.hidden) return;
    source = new EventSource(address);
    source.addEventListener("open", catchUp);
    source.addEventListener("progress", onProgress);
  }

  // What changed between the page's making and the stream's opening, or while it was cut, no event tells.
  function catchUp() {
    const list = document.getElementById("cards");
    (list ? [list] : document.querySelectorAll("[data-live]")).forEach(refresh);
  }

  function silence() {
    if (source) source.close();
    source = null;
  }

  document.addEventListener("visibilitychange", () => {
    if (document.hidden) silence();
    else listen();
  });
  window.addEventListener("pagehide", silence);
  window.addEventListener("pageshow", listen);

  // A table that was unfolded stays so when the part of the page around it is replaced.
  const unfolded = new Set();
  document.addEventListener("toggle", (event) => {
    if (event.target.id) unfolded[event.target.open ? "add" : "delete"](event.target.id);
  }, true);
  document.addEventListener("htmx:afterSwap", () => {
    unfolded.forEach((id) => document.getElementById(id)?.setAttribute("open", ""));
  });

  // The submit page: a chosen file is shown in the text field, errors lead to their line, assets are uploaded.
  function setUpSubmit(text) {
    const file = document.getElementById("file");
    file.addEventListener("change", async () => {
      if (file.files.length) text.value = await file.files[0].text();
    });
    document.querySelectorAll("[data-line]").forEach((link) => {
      link.addEventListener("click", (event) => {
        event.preventDefault();
        showLine(text, Number(link.dataset.line));
      });
    });
    document.querySelectorAll(".scripted").forEach((element) => { element.hidden = false; });
    const assets = document.getElementById("assets");
    assets.addEventListener("change", () => uploadAssets(text, [...assets.files]));
  }

  function showLine(text, line) {
    const lines = text.value.split("\n");
    const start = lines.slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
    text.focus();
    text.setSelectionRange(start, start + lines[line - 1].length);
    text.scrollTop = (line - 4) * (text.scrollHeight / lines.length);
  }

  async function uploadAssets(text, files) {
    const said = document.getElementById("assets-said");
    const lines = [];
    for (const file of files) {
      lines.push(await uploadAsset(text, file));
      said.textContent = lines.join(" ");
    }
  }

  async function uploadAsset(text, file) {
    const answer = await fetch("/v1/assets", { method: "POST", body: file });
    const found = await answer.json();
    if (!answer.ok) return `${file.name}: ${found.detail || found.title}.`;
    const name = file.name.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
    const pattern = new RegExp(`"file"\\s*:\\s*"(?:[^"]*/)?${name}"`, "g");
    const count = (text.value.match(pattern) || []).length;
    text.value = text.value.replace(pattern, `"asset": "${found.asset}"`);
    const where = count ? `put in its ${count === 1 ? "place" : `${count} places`}` : "not named in the scene";
    return `${file.name} is ${found.asset} (${found.detail}), ${where}.`;
  }

  document.addEventListener("DOMContentLoaded", () => {
    const text = document.getElementById("document");
    if (text) setUpSubmit(text);
    listen();
  });
})();
