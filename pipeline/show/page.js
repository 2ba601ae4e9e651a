// Draws a plan and moves its craft. All positions and separations come from the page's data.
"use strict";

const find = (id) => document.getElementById(id);
const data = JSON.parse(find("data").textContent);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
const narrow = matchMedia("(max-width: 40rem)");
const SECONDS = 15; // that a transfer takes to play
const PAUSE = 40; // ms between frames of play, in which a slow computer hears the button that stops it
const FEW = 12; // craft of which all numbers are shown
const AXES = ["x radial", "y along-track", "z cross-track"];

const state = {
  sample: 0,
  marked: data.pairs.length ? data.pairs[0] : [0],
  shown: { paths: true, initial: true, goal: true, numbers: true },
  playing: null, // when play began, were it at time 0
  due: false, // whether the plots are to be moved before the next frame
};

/** Plotly, which lies packed in the page. The page's policy knows it by its hash. */
async function unpackPlotly() {
  const bytes = Uint8Array.from(atob(find("plotly").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(stream).text();
  document.head.append(script);
}

/** A sphere about the origin: its points, and the triangles between them. */
function sphere(radius, rings = 7, sectors = 10) {
  const points = [[0, 0, radius]], triangles = [];
  const at = (ring, sector) => 1 + (ring - 1) * sectors + (sector % sectors);
  for (let ring = 1; ring < rings; ring++) {
    const tilt = (Math.PI * ring) / rings;
    for (let sector = 0; sector < sectors; sector++) {
      const turn = (2 * Math.PI * sector) / sectors;
      const [flat, high] = [radius * Math.sin(tilt), radius * Math.cos(tilt)];
      points.push([flat * Math.cos(turn), flat * Math.sin(turn), high]);
      const [a, b] = [at(ring, sector), at(ring, sector + 1)];
      if (ring === 1) triangles.push([0, a, b]);
      else triangles.push([a, b, at(ring - 1, sector)], [b, at(ring - 1, sector + 1), at(ring - 1, sector)]);
      if (ring === rings - 1) triangles.push([a, 1 + ring * sectors, b]);
    }
  }
  return { points: [...points, [0, 0, -radius]], triangles };
}

const ball = sphere(1);
const craft = data.positions.map((_, k) => k);
// What is drawn as a sphere or an ellipsoid: craft, then what they keep clear of.
const bodies = [
  ...data.positions.map((track, k) => ({ name: `craft ${k}`, track, axes: Array(3).fill(data.radii[k]) })),
  ...data.obstacles,
];

/** The surfaces of all bodies at the present sample: x, y and z of their points, m. */
function surfaces() {
  const place = (axis) => ({ track, axes }) =>
    ball.points.map((point) => track[state.sample][axis] / 100 + axes[axis] * point[axis]);
  return [0, 1, 2].map((axis) => bodies.flatMap(place(axis)));
}

/** The numbers of craft and where they stand at the present sample: clear of the spheres. */
function numbers() {
  const which = data.positions.length <= FEW ? craft : state.marked;
  const below = which.map((k) => k === state.marked[1]); // so that two that meet can be told apart
  const clear = (k) => [0, 0, 1.2 * data.radii[k]];
  const place = (axis) => which.map((k, n) =>
    data.positions[k][state.sample][axis] / 100 + (below[n] ? -1 : 1) * clear(k)[axis]);
  const positions = below.map((under) => (under ? "bottom center" : "top center"));
  return { text: which.map(String), at: [0, 1, 2].map(place), positions };
}

/** Lines one after the other in one trace, with gaps between. */
function lines(tracks, look, visible) {
  const axis = (k) => tracks.flatMap((track) => [...track.map((point) => point[k] / 100), null]);
  return {
    type: "scatter3d", mode: "lines", hoverinfo: "skip", showlegend: false, connectgaps: false,
    visible, x: axis(0), y: axis(1), z: axis(2), line: look,
  };
}

const BALLS = 0, NUMBERS = 1; // where they stand among the traces

function spaceTraces() {
  const [x, y, z] = surfaces(), many = ball.points.length;
  const faces = (corner) => bodies.flatMap((_, k) => ball.triangles.map((t) => k * many + t[corner]));
  const each = (value) => bodies.flatMap((_, k) => Array(many).fill(value(k)));
  const look = (k) => (k >= craft.length ? "limit" : state.marked.includes(k) ? "marked" : "craft");
  const { text, at, positions } = numbers(), { shown, marked } = state;
  return [
    {
      type: "mesh3d", x, y, z, i: faces(0), j: faces(1), k: faces(2), flatshading: false,
      vertexcolor: each((k) => colour(look(k))),
      text: each((k) => bodies[k].name), hovertemplate: "%{text}<extra></extra>",
      lighting: { ambient: 0.65, diffuse: 0.6, specular: 0.1 },
    },
    {
      type: "scatter3d", mode: "text", x: at[0], y: at[1], z: at[2], text,
      textposition: positions, textfont: { color: colour("ink"), size: 13 },
      hoverinfo: "skip", showlegend: false, visible: shown.numbers,
    },
    lines(data.orbits.initial, { color: colour("initial"), width: 2 }, shown.initial),
    lines(data.orbits.goal, { color: colour("goal"), width: 3, dash: "dash" }, shown.goal),
    lines(data.positions, { color: colour("faint"), width: 1.5 }, shown.paths),
    lines(data.corridors, { color: colour("pair3"), width: 2 }, shown.paths),
    lines(data.obstacles.map(({ track }) => track), { color: colour("limit"), width: 2 }, shown.paths),
    lines(marked.map((k) => data.positions[k]), { color: colour("marked"), width: 4 }, shown.paths),
  ];
}

/** What all plots have in common. */
function layout(more) {
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, uirevision: "kept",
    font: { color: colour("ink"), family: "system-ui, sans-serif", size: narrow.matches ? 11 : 12 },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("faint"), activecolor: colour("ink") },
    hoverlabel: { bgcolor: colour("panel"), bordercolor: colour("faint"), font: { color: colour("ink") } },
    ...more,
  };
}

function spaceLayout() {
  const axis = (title, k) => ({
    title: { text: narrow.matches ? `${title[0]}, m` : `${title}, m` }, range: data.box[k], gridcolor: colour("line"), zerolinecolor: colour("faint"),
    showbackground: false, showspikes: false, nticks: narrow.matches ? 4 : 6,
  });
  const extent = data.box.map(([low, high]) => high - low), away = narrow.matches ? 1.35 : 0.92;
  // A metre is as long on each; of a box that is nearly a cube less, so that its axes are in view.
  const longest = Math.max(...extent), cubic = Math.min(...extent) / longest;
  const ratio = extent.map((length) => length / longest / (0.9 + 0.5 * cubic));
  return layout({
    margin: { l: 0, r: 0, t: 0, b: 0 },
    scene: {
      aspectmode: "manual", aspectratio: { x: ratio[0], y: ratio[1], z: ratio[2] },
      xaxis: axis(AXES[0], 0), yaxis: axis(AXES[1], 1), zaxis: axis(AXES[2], 2),
      camera: { eye: { x: 1.1 * away, y: -1.0 * away, z: 0.75 * away } },
    },
  });
}

/** Flat axes: time, or what is drawn against it. */
const flat = (title, more) => ({
  title: { text: title }, gridcolor: colour("line"), zerolinecolor: colour("faint"), ...more,
});
const timeAxis = (more) => flat("time, s", { range: [0, data.times.at(-1)], zeroline: false, ...more });

/** The line that stands at the present time, across the whole height of a plot. */
const cursor = () => ({
  type: "line", yref: "paper", y0: 0, y1: 1, x0: data.times[state.sample], x1: data.times[state.sample],
  line: { color: colour("soft"), width: 1 },
});

function separationTraces() {
  const pairs = data.pairs.map(([i, j], k) => ({
    type: "scatter", mode: "lines", x: data.times, y: data.separations[k].map((mm) => mm / 1000),
    line: { color: colour(`pair${k}`), width: k ? 1.8 : 2.6 },
    name: `${i} and ${j}`, hovertemplate: "%{y:.3f} m at %{x:.1f} s",
  }));
  const least = {
    type: "scatter", mode: "lines", x: data.times, y: data.nearest.separations.map((mm) => mm / 1000),
    line: { color: colour("faint"), width: 1.5, dash: "dot" }, name: "any pair",
    hovertemplate: "%{y:.3f} m at %{x:.1f} s",
  };
  return [least, ...pairs.reverse()];
}

function separationLayout() {
  const shown = data.separations.map((all) => Math.min(...all) / 1000);
  const most = Math.max(...data.wanted), alike = most === Math.min(...data.wanted);
  const top = Math.max(4 * most, 2 * Math.max(...shown)), bound = data.bound ?? 0;
  const named = most === data.collisionRadius ? "r_col" : "both radii";
  const level = (y, look) => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: y, y1: y, line: look });
  const high = top / (narrow.matches ? 13 : 16); // of a label, more or less
  const label = (y, text, x, other, tint = "ink") => {
    const low = Math.min(y, other), gap = Math.abs(y - other);
    const under = low >= high || (y > other && gap >= high);
    // Below its line, over which curves pass, or below both, where there is room; else above.
    return {
      xref: "paper", x, xanchor: x ? "right" : "left", text, showarrow: false,
      y: gap < high ? (under ? low : Math.max(y, other)) : y,
      yanchor: under ? "top" : "bottom", yshift: under ? -2 : 2,
      bgcolor: colour("page"), opacity: 0.85, font: { color: colour(tint) },
    };
  };
  return layout({
    margin: { l: 50, r: 12, t: 30, b: 45 }, dragmode: narrow.matches ? false : "zoom",
    xaxis: timeAxis(), yaxis: flat("separation, m", { range: [0, top], zeroline: false }),
    shapes: [cursor(), ...(alike ? [
      level(most, { color: colour("limit"), width: 2, dash: "dash" }),
      level(bound, { color: colour("ink"), width: 1.5 }),
    ] : data.wanted.map((wanted, k) =>
      level(wanted, { color: colour(`pair${k}`), width: 1.8, dash: "dash" })))],
    annotations: alike ? [
      label(most, `${named} ${most} m`, 0, bound, "limit"),
      label(bound, `proven: never below ${(Math.floor(bound * 1000) / 1000).toFixed(3)} m`, 1, most),
    ] : [label(most, "dashed: both radii of each pair", 0, 0)],
  });
}

/** Controls as steps: all craft in grey, one trace an axis; then those of the marked. */
function controlTraces() {
  const steps = (k, axis) => [...data.controls[k].map((u) => u[axis]), data.controls[k].at(-1)[axis]];
  const trace = (which, axis, look, name) => ({
    type: "scatter", mode: "lines", line: { shape: "hv", ...look }, name, connectgaps: false,
    xaxis: "x", yaxis: axis ? `y${axis + 1}` : "y",
    x: which.flatMap(() => [...data.nodes, null]), y: which.flatMap((k) => [...steps(k, axis), null]),
    text: which.flatMap((k) => Array(data.nodes.length + 1).fill(`craft ${k}`)),
    hovertemplate: `%{text}: %{y:.4~f} mm/s², ${AXES[axis]}<extra></extra>`,
  });
  return [0, 1, 2].flatMap((axis) => [
    trace(craft, axis, { color: colour("faint"), width: 1 }, "all"),
    ...state.marked.map((k, order) =>
      trace([k], axis, { color: colour("marked"), width: 2.4, dash: order ? "dash" : "solid" }, `craft ${k}`)),
  ]);
}

function controlLayout() {
  const most = Math.max(data.limit ?? 0, ...data.controls.flat(2).map(Math.abs)) * 1.08 || 1;
  const axis = (k) => flat("", {
    domain: [0.7 - 0.35 * k, 0.97 - 0.35 * k], range: [-most, most], nticks: 5, zeroline: true,
  });
  const limits = data.limit === null ? [] : [0, 1, 2].flatMap((k) => [-1, 1].map((sign) => ({
    type: "line", xref: "paper", x0: 0, x1: 1, yref: k ? `y${k + 1}` : "y",
    y0: sign * data.limit, y1: sign * data.limit, line: { color: colour("limit"), width: 1.5, dash: "dash" },
  })));
  return layout({
    margin: { l: 50, r: 12, t: 16, b: 45 }, dragmode: narrow.matches ? false : "zoom",
    xaxis: timeAxis({ anchor: "y3" }), yaxis: axis(0), yaxis2: axis(1), yaxis3: axis(2),
    shapes: [cursor(), ...limits],
    annotations: AXES.map((name, k) => ({
      text: `${name}, mm/s²`, xref: "paper", yref: "paper", x: 0, xanchor: "left", y: 0.97 - 0.35 * k,
      yanchor: "bottom", showarrow: false,
    })),
  });
}

const PLOTS = {
  space: [spaceTraces, spaceLayout],
  ...(data.pairs.length ? { separation: [separationTraces, separationLayout] } : {}),
  controls: [controlTraces, controlLayout],
};
const CONFIG = {
  displaylogo: false, responsive: true, showTips: false,
  plotlyServerURL: "", // nothing here is for uploading
  modeBarButtonsToRemove: [
    "sendChartToCloud", "lasso2d", "select2d", "tableRotation", "resetCameraLastSave3d",
  ],
};

/** All plots anew: colours, what is shown and who is marked may have changed. */
const draw = () => Promise.all(Object.entries(PLOTS).map(([id, [traces, setting]]) =>
  Plotly.react(id, traces(), setting(), CONFIG)));

/** All plots at once in the size and colours of a sheet: a browser that prints waits for nothing. */
function drawPrinted() {
  for (const [id, [traces, setting]] of Object.entries(PLOTS)) {
    const { clientWidth: width, clientHeight: height } = find(id);
    Plotly.react(id, traces(), { ...setting(), width, height }, CONFIG);
  }
  dispatchEvent(new Event("resize")); // which the canvas in 3D waits for
  const drawn = find("space").querySelector("canvas"), copy = find("printed");
  if (!drawn) return; // a browser without WebGL
  find("space")._fullLayout.scene._scene.glplot.redraw();
  // Of that canvas browsers print what was on the screen, and so of a copy.
  [copy.width, copy.height] = [drawn.width, drawn.height];
  copy.getContext("2d").drawImage(drawn, 0, 0);
}

/** The words beside the slider: when it is, and who is closest then. */
function tell() {
  const time = data.times[state.sample].toFixed(1);
  let closest = "";
  if (data.nearest) {
    const [i, j] = data.nearest.pairs[state.sample];
    const apart = (data.nearest.separations[state.sample] / 1000).toFixed(3);
    closest = `; closest ${data.obstacles.length ? "craft " : ""}now ${i} and ${j}, ${apart} m`;
  }
  find("now").textContent = `${time} of ${data.times.at(-1).toFixed(0)} s${closest}`;
  find("time").value = state.sample;
  find("time").setAttribute("aria-valuetext", find("now").textContent);
}

/** Draw everything where it is at the present sample. */
function move() {
  const [x, y, z] = surfaces(), { at } = numbers(), { x0, x1 } = cursor();
  Plotly.restyle("space", { x: [x, at[0]], y: [y, at[1]], z: [z, at[2]] }, [BALLS, NUMBERS]);
  for (const id of Object.keys(PLOTS).filter((name) => name !== "space"))
    Plotly.relayout(id, { "shapes[0].x0": x0, "shapes[0].x1": x1 });
}

/** Go to a sample; of several within one frame only the last is drawn. */
function show(sample) {
  state.sample = sample;
  tell();
  if (!state.due) requestAnimationFrame(() => { state.due = false; move(); });
  state.due = true;
}

function stop() {
  state.playing = null;
  find("play").textContent = "Play";
}

/** One frame of play: the last sample that the time has reached. */
function frame(now) {
  if (state.playing === null) return;
  const end = data.times.at(-1), time = ((now - state.playing) / 1000 / SECONDS) * end;
  const next = data.times.findIndex((t) => t > time);
  const sample = next < 0 ? data.times.length - 1 : Math.max(next - 1, 0);
  if (sample !== state.sample) show(sample);
  if (next < 0) stop();
  else setTimeout(() => requestAnimationFrame(frame), PAUSE);
}

function play() {
  if (state.playing !== null) return stop();
  const end = data.times.at(-1);
  if (state.sample === data.times.length - 1) show(0);
  state.playing = performance.now() - (data.times[state.sample] / end) * SECONDS * 1000;
  find("play").textContent = "Pause";
  return requestAnimationFrame(frame);
}

/** The sample that is nearest to a time. */
const sampleAt = (time) =>
  data.times.reduce((best, t, k) => (Math.abs(t - time) < Math.abs(data.times[best] - time) ? k : best), 0);

function listen() {
  find("time").max = data.times.length - 1;
  find("time").addEventListener("input", (event) => { stop(); show(Number(event.target.value)); });
  find("play").addEventListener("click", play);
  for (const button of document.querySelectorAll("[data-time]"))
    button.addEventListener("click", () => {
      stop();
      const pair = data.pairs[button.closest("tr").rowIndex - 1];
      find("marked").value = pair.join();
      state.marked = pair;
      state.sample = sampleAt(Number(button.dataset.time));
      tell();
      draw();
    });
  for (const box of document.querySelectorAll("[data-part]"))
    box.addEventListener("change", () => { state.shown[box.dataset.part] = box.checked; draw(); });
  find("marked").addEventListener("change", ({ target }) => {
    state.marked = target.value.split(",").map(Number);
    draw();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  narrow.addEventListener("change", draw);
  for (const event of ["beforeprint", "afterprint"])
    addEventListener(event, () => {
      if (document.documentElement.toggleAttribute("data-print", event === "beforeprint")) drawPrinted();
      else draw().then(() => dispatchEvent(new Event("resize")));
    });
}

async function begin() {
  if (typeof DecompressionStream === "undefined") throw new Error("this browser is of before 2023");
  await unpackPlotly();
  listen();
  tell();
  await draw();
  document.documentElement.dataset.drawn = "yes";
}

begin().catch((error) => {
  find("fault").hidden = false;
  find("fault").textContent = `The plots could not be drawn: ${error.message}. The tables stand.`;
});
