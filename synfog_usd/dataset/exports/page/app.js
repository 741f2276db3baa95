"use strict";
// The gallery's page.  Knows data/index.js, and data/views/*.js one at a time; reads no file by itself.
(() => {
  const DATA = window.SYNFOG_INDEX || { title: "Gallery", words: {}, classes: [], rows: [], colours: {} };
  const at = (id) => document.getElementById(id);
  const FIELDS = ["split", "source", "lighting", "fog", "pipeline", "camera"]; // as row[5 + n] counts them
  const NAMED = { source: "recipe" };
  const NAME = 0, SCENE = 1, VIEW = 2, MOR = 3, BITS = 4, FIRST = 5;
  const CLIP = FIRST + FIELDS.length, FRAME = CLIP + 1; // of rows that are frames of a clip
  const THUMBS = 1000;
  const COLOUR = { visible: "#4cc38a", faint: "#ffb224", invisible: "#ff6369", unknown: "#9aa4ad" };
  const DASH = { visible: [], faint: [6, 3], invisible: [2, 3], unknown: [1, 3] };
  const OVERLAYS = ["boxes", "amodal boxes", "masks", "classes", "depth", "transmittance", "flow"];
  let chosen = {};       // filter -> index of a word, or of a class
  let shown = [];        // numbers of the rows that pass
  let opened = -1;       // number of the row whose page is open
  let view = null;       // its view, with planes read
  let series = [];       // the pictures of that view in its pipeline, from clear air to the thickest fog
  let highlighted = 0;
  const overlays = new Set(["boxes"]);

  // ---- filters

  const word = (row, field) => DATA.words[field][row[FIRST + FIELDS.indexOf(field)]];

  function makeFilters() {
    const form = at("filters");
    const add = (key, title, words) => {
      if (words.length < 2 && key !== "class") return;
      const label = document.createElement("label");
      label.append(title);
      const select = document.createElement("select");
      select.id = "filter-" + key;
      select.append(new Option("all", ""));
      const order = words.map((text, index) => [text || "own", index]);
      order.sort((a, b) => String(a[0]).localeCompare(String(b[0]), "en", { numeric: true }));
      for (const [text, index] of order) select.append(new Option(text, index));
      select.addEventListener("change", () => {
        if (select.value === "") delete chosen[key]; else chosen[key] = Number(select.value);
        filter();
        writeHash();
      });
      label.append(select);
      form.append(label);
    };
    for (const field of FIELDS) add(field, NAMED[field] || field, DATA.words[field] || []);
    add("class", "shows", DATA.classes);
    form.addEventListener("submit", (event) => event.preventDefault());
  }

  function filter() {
    const tests = FIELDS.filter((field) => field in chosen).map((field) => [FIRST + FIELDS.indexOf(field), chosen[field]]);
    const bit = "class" in chosen ? 2 ** chosen["class"] : 0;
    shown = [];
    for (let n = 0; n < DATA.rows.length; n++) {
      const row = DATA.rows[n];
      if (bit && Math.floor(row[BITS] / bit) % 2 === 0) continue;
      if (tests.every(([column, value]) => row[column] === value)) shown.push(n);
    }
    at("count").textContent = `${shown.length.toLocaleString("en")} of ${DATA.rows.length.toLocaleString("en")} pictures`;
    at("grid").scrollTop = 0;
    layout();
  }

  // ---- the grid: only what is near the window exists

  const cards = new Map();
  let columns = 1, cardWidth = 200, cardHeight = 150;
  const GAP = 10;

  function layout() {
    const width = at("grid").clientWidth - GAP;
    columns = Math.max(width < 420 ? 2 : 1, Math.floor(width / 230));
    cardWidth = Math.floor(width / columns) - GAP;
    cardHeight = Math.round(cardWidth * 9 / 16) + 48;
    at("space").style.height = `${Math.ceil(shown.length / columns) * (cardHeight + GAP) + GAP}px`;
    for (const card of cards.values()) card.remove();
    cards.clear();
    const none = at("none");
    if (none) none.remove();
    if (!shown.length) {
      const text = document.createElement("p");
      text.id = "none";
      text.textContent = "No picture passes these filters.";
      at("space").append(text);
    }
    draw();
  }

  function draw() {
    const grid = at("grid");
    if (grid.hidden) return;
    const first = Math.max(0, Math.floor(grid.scrollTop / (cardHeight + GAP)) - 1) * columns;
    const last = Math.min(shown.length, (Math.ceil((grid.scrollTop + grid.clientHeight) / (cardHeight + GAP)) + 1) * columns);
    for (const [place, card] of cards) if (place < first || place >= last) { card.remove(); cards.delete(place); }
    for (let place = first; place < last; place++) if (!cards.has(place)) cards.set(place, makeCard(place));
  }

  function makeCard(place) {
    const number = shown[place], row = DATA.rows[number];
    const card = document.createElement("a");
    card.className = "card";
    card.href = "#shot=" + encodeURIComponent(row[NAME]);
    card.dataset.place = place;
    card.style.cssText = `left:${GAP + (place % columns) * (cardWidth + GAP)}px;top:${GAP + Math.floor(place / columns) * (cardHeight + GAP)}px;width:${cardWidth}px;height:${cardHeight}px`;
    const image = document.createElement("img");
    image.loading = "lazy";
    image.decoding = "async";
    image.alt = `${word(row, "source")}, ${word(row, "lighting")}, ${word(row, "fog")}`;
    image.style.height = `${cardHeight - 46}px`;
    image.src = `thumbs/${String(Math.floor(number / THUMBS)).padStart(3, "0")}/${number}.jpg`;
    const one = document.createElement("span"), two = document.createElement("span"), bold = document.createElement("b");
    bold.textContent = `${row[SCENE]} ${word(row, "source")}`;
    one.append(bold);
    two.textContent = `${word(row, "lighting")} · ${word(row, "fog")} · ${word(row, "split")}`;
    card.append(image, one, two);
    card.title = row[NAME];
    at("space").append(card);
    return card;
  }

  let waiting = false;
  at("grid").addEventListener("scroll", () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  }, { passive: true });

  at("grid").addEventListener("keydown", (event) => {
    const card = event.target.closest && event.target.closest(".card");
    const step = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: columns, ArrowUp: -columns, Home: -Infinity, End: Infinity }[event.key];
    if (step === undefined) return;
    event.preventDefault();
    const from = card ? Number(card.dataset.place) : -1;
    focusCard(card ? Math.max(0, Math.min(shown.length - 1, from + step)) : 0);
  });

  function focusCard(place) {
    const grid = at("grid"), top = GAP + Math.floor(place / columns) * (cardHeight + GAP);
    if (top < grid.scrollTop) grid.scrollTop = top - GAP;
    if (top + cardHeight > grid.scrollTop + grid.clientHeight) grid.scrollTop = top + cardHeight + GAP - grid.clientHeight;
    draw();
    if (cards.has(place)) cards.get(place).focus({ preventScroll: true });
  }

  // ---- the page of a picture

  const views = new Map();
  window.SYNFOG_VIEW = (number, data) => { const done = views.get(number); if (done) done(data); };

  function loadView(number) {
    return new Promise((resolve, reject) => {
      const script = document.createElement("script");
      views.set(number, (data) => { views.delete(number); script.remove(); resolve(data); });
      script.onerror = () => { views.delete(number); script.remove(); reject(new Error("its data file is missing")); };
      script.src = `data/views/${String(Math.floor(number / THUMBS)).padStart(3, "0")}/${number}.js`;
      document.head.append(script);
    });
  }

  function readPlane(uri) {
    return new Promise((resolve, reject) => {
      const image = new Image();
      image.onload = () => {
        const canvas = document.createElement("canvas");
        canvas.width = image.width;
        canvas.height = image.height;
        const context = canvas.getContext("2d", { willReadFrequently: true, colorSpace: "srgb" });
        context.drawImage(image, 0, 0);
        resolve({ width: image.width, height: image.height, bytes: context.getImageData(0, 0, image.width, image.height).data });
      };
      image.onerror = () => reject(new Error("a plane is damaged"));
      image.src = uri;
    });
  }

  const pairAt = (plane, x, y) => { const n = 4 * (y * plane.width + x); return plane.bytes[n] * 256 + plane.bytes[n + 1]; };
  const idAt = (plane, x, y) => { const n = 4 * (y * plane.width + x); return plane.bytes[n] + 256 * plane.bytes[n + 1] + 65536 * plane.bytes[n + 2]; };

  async function open(number) {
    opened = number;
    const row = DATA.rows[number];
    at("grid").hidden = at("bar").hidden = true;
    at("shot").hidden = false;
    const place = shown.indexOf(number);
    at("previous").disabled = place <= 0;
    at("next").disabled = place < 0 || place >= shown.length - 1;
    if (!view || view.number !== row[VIEW]) {
      try {
        const data = await loadView(row[VIEW]);
        const planes = {};
        for (const name of Object.keys(data.planes)) planes[name] = await readPlane(data.planes[name]);
        data.planes = planes;
        data.number = row[VIEW];
        if (opened !== number) return;
        view = data;
        highlighted = 0;
      } catch (error) {
        at("name").textContent = row[NAME];
        at("pointer").textContent = `This picture cannot be shown: ${error.message}.`;
        return;
      }
    }
    at("play").hidden = row[CLIP] === undefined;
    const pipeline = word(row, "pipeline");
    series = view.pictures.filter((picture) => picture.pipeline === pipeline);
    series.sort((a, b) => (b.mor_m === null ? Infinity : b.mor_m) - (a.mor_m === null ? Infinity : a.mor_m) || 0);
    const index = Math.max(0, series.findIndex((picture) => picture.name === row[NAME]));
    const slider = at("slider");
    slider.max = Math.max(0, series.length - 1);
    slider.disabled = series.length < 2;
    slider.value = index;
    at("stage").style.aspectRatio = `${view.size[0]} / ${view.size[1]}`;
    at("stage").style.maxWidth = `calc(76vh * ${view.size[0] / view.size[1]})`;
    at("pointer").textContent = "Point at the picture.";
    await slide();
    if (opened !== number) return;
    at("name").textContent = document.body.dataset.ready = row[NAME];
  }

  // ---- clips

  let playing = 0; // ticket of what plays; 0 where nothing does
  let tickets = 0;

  async function play() {
    if (playing || opened < 0 || DATA.rows[opened][CLIP] === undefined) { stop(); return; }
    const ticket = playing = ++tickets, clip = DATA.rows[opened][CLIP];
    const frames = DATA.rows.map((_, number) => number).filter((number) => DATA.rows[number][CLIP] === clip);
    frames.sort((a, b) => DATA.rows[a][FRAME] - DATA.rows[b][FRAME]);
    at("play").textContent = "Stop";
    while (ticket === playing && frames.includes(opened)) {
      const begun = performance.now(), next = frames[(frames.indexOf(opened) + 1) % frames.length];
      history.replaceState(null, "", "#shot=" + encodeURIComponent(DATA.rows[next][NAME]));
      await open(next);
      await new Promise((done) => setTimeout(done, Math.max(0, 1000 / DATA.per_s[clip] - (performance.now() - begun))));
    }
    if (ticket === playing) stop();
  }

  function stop() {
    playing = 0;
    at("play").textContent = "Play";
  }

  // Neighbours differ most where the hue goes on by the golden ratio.
  const trackHue = (track) => Math.round(360 * (track * 0.6180339887 % 1));

  function close() {
    const from = opened;
    stop();
    opened = -1;
    view = null;
    series = [];
    delete document.body.dataset.ready;
    at("shot").hidden = true;
    at("grid").hidden = at("bar").hidden = false;
    layout();
    if (shown.indexOf(from) >= 0) focusCard(shown.indexOf(from));
  }

  const current = () => series[Math.round(Number(at("slider").value))];
  const leftOf = (thing) => view.fogs[current().fog].left[thing.id] || [null, null, null, null];
  const stateOf = (thing) => leftOf(thing)[3] || "unknown";

  let asked = 0;
  async function slide() {
    const ticket = ++asked, value = Number(at("slider").value), low = Math.floor(value), share = value - low;
    const one = series[low], other = series[Math.min(low + 1, series.length - 1)], picture = current();
    const fog = view.fogs[picture.fog];
    if (!fog.plane) fog.plane = await readPlane(fog.transmittance);
    if (picture.raw && !picture.raw.plane) picture.raw.plane = await readPlane(picture.raw.uri);
    await Promise.all([one, other].map((each) => decoded(each.screen)));
    if (ticket !== asked || !view) return;
    const set = (image, { screen }) => { if (image.getAttribute("src") !== screen) image.src = screen; };
    set(at("under"), one);
    set(at("over"), other);
    at("over").style.opacity = share;
    at("fogname").textContent = share && share < 1 ? `${one.fog} → ${other.fog}` : picture.mor_m === null ? picture.fog : `${picture.fog} (${picture.mor_m} m)`;
    at("under").alt = picture.name;
    fillTable();
    fillFiles(picture);
    drawHistogram(picture);
    drawPlane();
    drawMarks();
  }

  function decoded(uri) { // so that a picture and its boxes change together
    const image = new Image();
    image.src = uri;
    return image.decode().catch(() => null);
  }

  function fillTable() {
    const body = at("things").tBodies[0];
    body.replaceChildren();
    const order = { visible: 0, faint: 1, invisible: 2, unknown: 3 };
    const rows = view.things.slice().sort((a, b) => order[stateOf(a)] - order[stateOf(b)] || (a.distance_m || 0) - (b.distance_m || 0));
    for (const thing of rows) {
      const [clear, contrast, cnr] = leftOf(thing), line = document.createElement("tr");
      const text = [thing.label, thing.distance_m === undefined ? "" : thing.distance_m.toFixed(1), number(clear), number(contrast), number(cnr), stateOf(thing)];
      text.forEach((value) => { const cell = document.createElement("td"); cell.textContent = value; line.append(cell); });
      line.lastChild.className = stateOf(thing);
      line.title = thing.path;
      line.classList.toggle("chosen", thing.id === highlighted);
      line.addEventListener("mouseenter", () => { highlighted = thing.id; drawMarks(); });
      body.append(line);
    }
  }

  const number = (value) => value === null || value === undefined ? "–" : Math.abs(value) >= 100 ? value.toFixed(0) : Number(value.toPrecision(3)).toString();

  function fillFiles(picture) {
    at("files").replaceChildren(...Object.keys(picture.files).map((name) => {
      const item = document.createElement("li"), link = document.createElement("a");
      link.href = picture.files[name];
      link.download = name.includes("labels") ? name : `${picture.name}-${name}`;
      link.textContent = name;
      item.append(link);
      return item;
    }));
  }

  function drawHistogram(picture) {
    const canvas = at("histogram"), context = canvas.getContext("2d");
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.globalCompositeOperation = "lighter";
    const most = Math.max(1, ...picture.histogram.flat().map(Math.sqrt));
    picture.histogram.forEach((bins, channel) => {
      context.fillStyle = ["#c0392b", "#27a050", "#2f6fd0"][channel];
      bins.forEach((count, bin) => {
        const height = Math.sqrt(count) / most * canvas.height;
        context.fillRect(bin * canvas.width / bins.length, canvas.height - height, canvas.width / bins.length, height);
      });
    });
    context.globalCompositeOperation = "source-over";
  }

  const heat = (t) => { // dark blue, violet, orange, pale yellow: rising lightness
    const stops = [[13, 8, 70], [126, 3, 168], [225, 100, 98], [252, 180, 60], [240, 249, 180]];
    const place = Math.max(0, Math.min(0.9999, t)) * 4, n = Math.floor(place), f = place - n;
    return [0, 1, 2].map((c) => stops[n][c] + f * (stops[n + 1][c] - stops[n][c]));
  };

  function drawPlane() {
    const canvas = at("plane"), ids = view.planes.id, width = ids.width, height = ids.height;
    canvas.width = width;
    canvas.height = height;
    const kind = ["flow", "transmittance", "depth", "classes", "masks"].find((name) => overlays.has(name));
    const context = canvas.getContext("2d");
    if (!kind || (kind === "flow" && !view.planes.flow)) return;
    const image = context.createImageData(width, height), states = new Map();
    for (const thing of view.things) states.set(thing.id, stateOf(thing));
    const classColour = semanticColours();
    for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
      const n = 4 * (y * width + x);
      let colour = null, alpha = 170;
      if (kind === "masks") {
        const state = states.get(idAt(ids, x, y));
        if (state) { const hex = COLOUR[state]; colour = [1, 3, 5].map((c) => parseInt(hex.slice(c, c + 2), 16)); alpha = 130; }
      } else if (kind === "flow") {
        colour = view.planes.flow.bytes.subarray(n, n + 3);
      } else if (kind === "classes") {
        colour = classColour[view.planes.semantic.bytes[n]] || [0, 0, 0];
      } else if (kind === "depth") {
        const steps = pairAt(view.planes.depth, x, y);
        if (steps) colour = heat(1 - Math.log(steps / 64) / Math.log(500));
      } else {
        const plane = view.fogs[current().fog].plane;
        if (plane) colour = heat(pairAt(plane, x, y) / 65535);
      }
      if (colour) { image.data[n] = colour[0]; image.data[n + 1] = colour[1]; image.data[n + 2] = colour[2]; image.data[n + 3] = alpha; }
    }
    context.putImageData(image, 0, 0);
  }

  const IDS = ["unlabeled", "ego vehicle", "rectification border", "out of roi", "static", "dynamic", "ground", "road", "sidewalk", "parking", "rail track", "building", "wall", "fence", "guard rail", "bridge", "tunnel", "pole", "polegroup", "traffic light", "traffic sign", "vegetation", "terrain", "sky", "person", "rider", "car", "truck", "bus", "caravan", "trailer", "train", "motorcycle", "bicycle"];
  const semanticColours = () => IDS.map((name) => DATA.colours[name]);

  function drawMarks() {
    const canvas = at("marks"), ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    const context = canvas.getContext("2d"), scale = canvas.width / view.size[0];
    const box = (rectangle, thing, bold) => {
      const state = stateOf(thing);
      context.strokeStyle = thing.track === undefined ? COLOUR[state] : `hsl(${trackHue(thing.track)} 85% 60%)`;
      context.lineWidth = (bold ? 3 : 1.5) * ratio;
      context.setLineDash(DASH[state].map((length) => length * ratio));
      context.strokeRect(rectangle[0] * scale, rectangle[1] * scale, rectangle[2] * scale, rectangle[3] * scale);
    };
    for (const thing of view.things) {
      const bold = thing.id === highlighted;
      if (overlays.has("amodal boxes") && thing.amodal_box_px) box(thing.amodal_box_px, thing, bold);
      if (overlays.has("boxes") || bold) box(thing.box_px, thing, bold);
    }
  }

  function point(event) {
    if (!view || !series.length) return;
    const area = at("marks").getBoundingClientRect();
    const x = Math.floor((event.clientX - area.left) / area.width * view.size[0]), y = Math.floor((event.clientY - area.top) / area.height * view.size[1]);
    if (x < 0 || y < 0 || x >= view.size[0] || y >= view.size[1]) return;
    const ids = view.planes.id, px = Math.min(ids.width - 1, Math.floor(x / view.step)), py = Math.min(ids.height - 1, Math.floor(y / view.step));
    const id = idAt(ids, px, py), steps = pairAt(view.planes.depth, px, py), picture = current();
    const fog = view.fogs[picture.fog].plane, clear = fog ? pairAt(fog, px, py) / 65535 : null;
    const thing = view.things.find((one) => one.id === id);
    const label = IDS[view.planes.semantic.bytes[4 * (py * ids.width + px)]] || "";
    const depth = steps === 0 ? "sky" : steps === 65535 ? "beyond 1023 m" : `${(steps / 64).toFixed(2)} m`;
    let raw = "";
    if (picture.raw && picture.raw.plane) {
      const wide = picture.raw.plane, width = wide.width / 4;
      const rx = Math.min(width - 1, Math.floor(x / picture.raw.step)), ry = Math.min(wide.height - 1, Math.floor(y / picture.raw.step));
      const values = [0, 1, 2, 3].map((n) => pairAt(wide, n * width + rx, ry) - 32768);
      raw = `\nRAW above black ${picture.raw.pattern ? "(" + picture.raw.pattern + ") " : ""}${values.join(" ")} DN`;
    }
    at("pointer").textContent = `x ${x} y ${y}   ${label}   planar depth ${depth}   T ${number(clear)}${raw}` + (thing ? `\n${thing.path}: ${stateOf(thing)}, ${Math.round(100 * (thing.visible_share ?? 1))} % in view` : "");
    const before = highlighted;
    highlighted = thing ? id : 0;
    if (before !== highlighted) {
      drawMarks();
      const lines = at("things").tBodies[0].rows;
      for (const line of lines) line.classList.toggle("chosen", !!thing && line.title === thing.path);
    }
  }

  function makeOverlays() {
    OVERLAYS.forEach((name, index) => {
      const label = document.createElement("label"), box = document.createElement("input");
      box.type = "checkbox";
      box.id = "overlay-" + name.replace(" ", "-");
      box.checked = overlays.has(name);
      box.addEventListener("change", () => toggle(name, box.checked));
      label.append(box, ` ${name}`);
      label.title = `Key ${index + 1}`;
      at("overlays").append(label);
    });
  }

  function toggle(name, on) {
    const planes = ["masks", "classes", "depth", "transmittance", "flow"];
    if (on && planes.includes(name)) planes.forEach((other) => overlays.delete(other));
    if (on) overlays.add(name); else overlays.delete(name);
    for (const each of OVERLAYS) at("overlay-" + each.replace(" ", "-")).checked = overlays.has(each);
    if (view) { drawPlane(); drawMarks(); }
  }

  // ---- where one is: the address after '#'

  function writeHash() {
    const parts = Object.keys(chosen).map((key) => `${key}=${encodeURIComponent((key === "class" ? DATA.classes : DATA.words[key])[chosen[key]])}`);
    history.replaceState(null, "", "#" + parts.join("&"));
  }

  function readHash() {
    const found = new URLSearchParams(location.hash.slice(1)), shot = found.get("shot");
    if (shot !== null) {
      const number = DATA.rows.findIndex((row) => row[NAME] === shot);
      if (number >= 0) { open(number); return; }
    }
    if (opened >= 0) { close(); writeHash(); return; }
    for (const [key, text] of found) {
      const words = key === "class" ? DATA.classes : DATA.words[key];
      const index = words ? words.indexOf(text) : -1, select = at("filter-" + key);
      if (index >= 0 && select) { chosen[key] = index; select.value = index; }
    }
    filter();
  }

  const go = (number) => { location.hash = "#shot=" + encodeURIComponent(DATA.rows[number][NAME]); };
  const step = (by) => { const place = shown.indexOf(opened) + by; if (place >= 0 && place < shown.length) go(shown[place]); };

  at("back").addEventListener("click", () => { location.hash = ""; });
  at("previous").addEventListener("click", () => step(-1));
  at("next").addEventListener("click", () => step(1));
  at("play").addEventListener("click", play);
  at("slider").addEventListener("input", slide);
  at("slider").addEventListener("change", () => { at("slider").value = Math.round(Number(at("slider").value)); slide(); });
  at("marks").addEventListener("pointermove", point);
  at("marks").addEventListener("pointerdown", point);
  window.addEventListener("hashchange", readHash);
  window.addEventListener("resize", () => { if (opened < 0) layout(); else if (view && series.length) drawMarks(); });
  document.addEventListener("keydown", (event) => {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    if (opened < 0) return;
    const inField = ["INPUT", "SELECT"].includes(document.activeElement.tagName) && document.activeElement.type !== "checkbox";
    if (event.key === "Escape") location.hash = "";
    else if (event.key >= "1" && event.key <= String(OVERLAYS.length)) toggle(OVERLAYS[Number(event.key) - 1], !overlays.has(OVERLAYS[Number(event.key) - 1]));
    else if (inField) return;
    else if (event.key === " " && document.activeElement.tagName !== "BUTTON") { event.preventDefault(); play(); }
    else if (event.key === "ArrowLeft") step(-1);
    else if (event.key === "ArrowRight") step(1);
    else if (event.key === "+" || event.key === "-") {
      at("slider").value = Math.round(Number(at("slider").value)) + (event.key === "+" ? 1 : -1);
      slide();
    }
  });

  document.title = DATA.title;
  at("title").textContent = DATA.title;
  makeFilters();
  makeOverlays();
  shown = DATA.rows.map((_, number) => number);
  if (new URLSearchParams(location.hash.slice(1)).has("shot")) { filter(); }
  readHash();
})();
