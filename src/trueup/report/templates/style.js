// How the figures look: one palette for light and dark, distinguishable without seeing red and green apart.

const LIGHT = {
  measured: "#30363b", before: "#d8690f", after: "#0b67ad", command: "#9aa3aa", ink: "#1f2429", soft: "#5c656e",
  grid: "#e8eae9", zero: "#c6cac9", noise: "rgba(92,101,110,0.13)", worst: "rgba(216,105,15,0.10)",
  ground: "#fcfcfa", raised: "#ffffff", low: "#b35806", middle: "#f7f7f5", high: "#0b5c9c",
};
const DARK = {
  measured: "#e6e8ea", before: "#f0913f", after: "#62b0ec", command: "#7c868f", ink: "#e6e8ea", soft: "#a3acb4",
  grid: "#2a3035", zero: "#444c53", noise: "rgba(163,172,180,0.16)", worst: "rgba(240,145,63,0.14)",
  ground: "#16191c", raised: "#1c2024", low: "#f0913f", middle: "#24292e", high: "#62b0ec",
};
const darkMode = window.matchMedia("(prefers-color-scheme: dark)");
let printing = false;

function palette() {
  return darkMode.matches && !printing ? DARK : LIGHT;
}

// The buttons are listed, not left to Plotly: one of its own would send the data to a server.
const CONFIG = {
  responsive: true, displaylogo: false, doubleClick: "reset", displayModeBar: "hover", plotlyServerURL: "",
  modeBarButtons: [["zoom2d", "pan2d", "resetScale2d"], ["toImage"]],
  toImageButtonOptions: { format: "svg", filename: "trueup" },
};

// Plotly reads some HTML in texts; names are only names
function plain(text) {
  return String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
}

function shortened(text, most) {
  const letters = Array.from(text);
  return letters.length <= most ? text : letters.slice(0, Math.ceil(most / 2) - 1).join("") + "…" +
    letters.slice(letters.length - Math.floor(most / 2)).join("");
}

function axis(title, more) {
  const p = palette();
  return Object.assign({
    title: { text: plain(title), font: { size: 12.5, color: p.soft }, standoff: 8 },
    gridcolor: p.grid, zerolinecolor: p.zero, zerolinewidth: 1, linecolor: p.zero, tickcolor: p.zero,
    tickfont: { size: 12, color: p.soft }, automargin: true, ticklen: 0,
  }, more || {});
}

function layout(more) {
  const p = palette();
  const font = getComputedStyle(document.body).fontFamily;
  return Object.assign({
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { family: font, size: 13, color: p.ink },
    margin: { l: 62, r: 8, t: 30, b: 44 }, hovermode: "closest", dragmode: "zoom",
    hoverlabel: { bgcolor: p.raised, bordercolor: p.zero, font: { size: 12.5, color: p.ink, family: font } },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: p.soft, activecolor: p.ink },
    legend: { orientation: "h", x: 0, y: 1.0, yanchor: "bottom", font: { size: 12.5, color: p.ink }, itemsizing: "constant" },
    separators: ".\u202f",
  }, more);
}

function draw(id, traces, arrangement, changes) {
  const place = document.getElementById(id);
  if (place) Plotly.react(place, traces, arrangement, { ...CONFIG, ...changes });
}

// a quiet remark in place of a figure that cannot be drawn
function remark(id, text) {
  draw(id, [], layout({
    xaxis: { visible: false, range: [0, 1] }, yaxis: { visible: false, range: [0, 1] },
    annotations: [{ text: plain(text), x: 0.5, y: 0.5, showarrow: false, font: { color: palette().soft, size: 13 } }],
  }));
}
