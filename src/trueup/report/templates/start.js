// Connecting controls and figures, once, when the file is opened.

const MANY = 12; // labels beyond this are chosen from a list

function fillRecordings() {
  const select = document.getElementById("recording");
  const channels = new Set(DATA.replays.map((r) => r.channel));
  const groups = new Map();
  DATA.replays.forEach((replay, index) => {
    const kind = replay.heldOut ? "Held out" : "Fitted";
    const title = channels.size > 1 ? `${replay.channel}: ${kind}` : kind;
    if (!groups.has(title)) {
      const group = document.createElement("optgroup");
      group.label = title;
      groups.set(title, group);
      select.append(group);
    }
    groups.get(title).append(new Option(replay.recording, String(index)));
  });
  select.addEventListener("change", () => show(Number(select.value), sameLabel(Number(select.value)), false));
}

// the joint that is shown, in another recording
function sameLabel(index) {
  const label = DATA.replays[shown.replay].labels[shown.column];
  return Math.max(0, DATA.replays[index].labels.indexOf(label));
}

function fillLabels() {
  const place = document.getElementById("labels"), labels = DATA.replays[shown.replay].labels;
  if (labels.length > MANY) {
    const select = document.createElement("select");
    select.setAttribute("aria-label", "Joint");
    labels.forEach((label, j) => select.append(new Option(label, String(j), false, j === shown.column)));
    select.addEventListener("change", () => show(shown.replay, Number(select.value), true));
    place.replaceChildren(select);
    return;
  }
  place.replaceChildren(...labels.map((label, j) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = label;
    button.title = label;
    button.setAttribute("aria-pressed", String(j === shown.column));
    button.addEventListener("click", () => show(shown.replay, j, true));
    return button;
  }));
}

// keep: stay at the moment that is zoomed to, as another joint of the same recording is chosen
function show(replay, column_, keep, window_) {
  const stay = keep && replay === shown.replay ? currentWindow() : null;
  shown.replay = replay;
  shown.column = column_;
  document.getElementById("recording").value = String(replay);
  fillLabels();
  for (const button of document.querySelectorAll(".heat button")) {
    const here = Number(button.dataset.replay) === replay && Number(button.dataset.column) === column_;
    button.setAttribute("aria-current", String(here));
  }
  drawReplay(window_ || stay);
  drawSpectrum();
  drawSpeed();
  titleDetails();
}

function drawAll() {
  if (DATA.replays.length) show(shown.replay, shown.column, true);
  drawTrace();
  drawCorrelation();
}

function connect() {
  const far = () => document.getElementById("replay").scrollIntoView({ block: "start" });
  for (const button of document.querySelectorAll(".heat button")) {
    button.addEventListener("click", () => {
      show(Number(button.dataset.replay), Number(button.dataset.column), true);
      far();
    });
  }
  for (const button of document.querySelectorAll("button[data-moment]")) {
    button.addEventListener("click", () => {
      const replay = Number(button.dataset.moment);
      show(replay, Math.max(0, DATA.replays[replay].labels.indexOf(button.dataset.label)), false);
      drawReplay(worstWindow());
      far();
    });
  }
  document.getElementById("worst").addEventListener("click", () => drawReplay(worstWindow()));
  document.getElementById("whole").addEventListener("click", () => drawReplay(null));
}

const parameters = document.getElementById("parameters");
if (parameters) {
  sortable(parameters);
  filterable(parameters);
}
if (DATA.replays.length) {
  fillRecordings();
  connect();
}
drawAll();
darkMode.addEventListener("change", drawAll);
window.addEventListener("beforeprint", () => { printing = true; drawAll(); });
window.addEventListener("afterprint", () => { printing = false; drawAll(); });
