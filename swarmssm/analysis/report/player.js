(() => {
  "use strict";
  const UNKNOWN = 65535, NO_DIRECTION = 255, TURN = 2 * Math.PI;
  const MANY_EDGES = 500;
  // An individual that looks along the first axis, as in the films; of length 1.
  const DART = [[0.6, 0], [-0.4, 0.3], [-0.2, 0], [-0.4, -0.3]];

  // The format is that of player_data.py.
  async function unpack(scene) {
    const squeezed = Uint8Array.from(atob(scene.bytes), (letter) => letter.charCodeAt(0));
    const stream = new Blob([squeezed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const frames = scene.frames, count = scene.individuals.length;
    const numbers = new Uint16Array(count * 2 * frames);
    const total = numbers.length;
    for (let line = 0; line < count * 2; line += 1) {
      let value = 0;
      for (let frame = 0; frame < frames; frame += 1) {
        const place = line * frames + frame;
        value = (value + bytes[place] + 256 * bytes[total + place]) & 65535;
        numbers[place] = value;
      }
    }
    const looks = bytes.subarray(2 * total, 2 * total + count * frames);
    const bits = scene.graph ? bytes.subarray(2 * total + count * frames) : null;
    return {
      frames, count, names: scene.individuals, colours: scene.colours, graph: scene.graph,
      // Where an individual was, or null.
      at(frame, one) {
        const x = numbers[2 * one * frames + frame];
        if (x === UNKNOWN) return null;
        const y = numbers[(2 * one + 1) * frames + frame];
        return [scene.offset[0] + scene.resolution * x, scene.offset[1] + scene.resolution * y];
      },
      // Radians, or null.
      heading(frame, one) {
        const step = looks[one * frames + frame];
        return step === NO_DIRECTION ? null : (step / 255) * TURN;
      },
      // Whether one sees the other.
      sees(frame, one, other) {
        const bit = (frame * count + one) * count + other;
        return bits !== null && (bits[bit >> 3] & (128 >> (bit & 7))) !== 0;
      },
    };
  }

  // The longest of 1, 2, 5, 10, ... that is at most so long.
  function roundLength(most) {
    const power = 10 ** Math.floor(Math.log10(most));
    return power * [5, 2, 1].find((step) => step * power <= most);
  }

  function picture(canvas, scene, film, shown) {
    const [left, right, bottom, top] = film.box;
    let width = 1, height = 1, sharpness = 1;

    function resize() {
      sharpness = window.devicePixelRatio || 1;
      width = canvas.clientWidth;
      height = canvas.clientHeight;
      canvas.width = Math.max(1, Math.round(width * sharpness));
      canvas.height = Math.max(1, Math.round(height * sharpness));
    }

    function draw(frame) {
      const pen = canvas.getContext("2d");
      const scale = Math.min(width / (right - left), height / (top - bottom));
      const toX = (x) => width / 2 + (x - (left + right) / 2) * scale;
      const toY = (y) => height / 2 - (y - (bottom + top) / 2) * scale;
      const length = Math.max(film.length * scale, 5);
      const colour = (name) => getComputedStyle(canvas).getPropertyValue(name).trim();
      const places = [];
      for (let one = 0; one < scene.count; one += 1) {
        const place = scene.at(frame, one);
        places.push(place && [toX(place[0]), toY(place[1])]);
      }
      pen.setTransform(sharpness, 0, 0, sharpness, 0, 0);
      pen.clearRect(0, 0, width, height);
      if (shown.tails) drawTails(pen, frame, toX, toY);
      if (shown.edges && scene.graph) drawEdges(pen, frame, places, length, colour("--player-edge"));
      places.forEach((place, one) => {
        if (place) drawBody(pen, place, scene.heading(frame, one), length, scene.colours[one]);
      });
      const ink = colour("--player-ink");
      if (shown.names) {
        pen.font = "12px system-ui, sans-serif";
        pen.fillStyle = ink;
        places.forEach((place, one) => {
          if (place) pen.fillText(scene.names[one], place[0] + 0.6 * length, place[1] - 0.5 * length);
        });
      }
      drawScale(pen, scale, ink);
    }

    function drawTails(pen, frame, toX, toY) {
      pen.lineWidth = 1.5;
      pen.lineCap = "round";
      for (let one = 0; one < scene.count; one += 1) {
        pen.strokeStyle = scene.colours[one];
        let before = null;
        for (let back = Math.min(film.tail, frame); back >= 0; back -= 1) {
          const place = scene.at(frame - back, one);
          if (place && before) {
            pen.globalAlpha = 0.75 * (1 - back / Math.max(film.tail, 1));
            pen.beginPath();
            pen.moveTo(toX(before[0]), toY(before[1]));
            pen.lineTo(toX(place[0]), toY(place[1]));
            pen.stroke();
          }
          before = place;
        }
      }
      pen.globalAlpha = 1;
    }

    function drawEdges(pen, frame, places, length, colour) {
      const lines = [], arrows = [];
      for (let one = 0; one < scene.count; one += 1) {
        for (let other = one + 1; other < scene.count; other += 1) {
          if (!places[one] || !places[other]) continue;
          const there = scene.sees(frame, one, other), back = scene.sees(frame, other, one);
          if (there && back) lines.push([places[one], places[other]]);
          else if (there) arrows.push([places[one], places[other]]);
          else if (back) arrows.push([places[other], places[one]]);
        }
      }
      pen.strokeStyle = pen.fillStyle = colour;
      pen.lineWidth = 1;
      pen.globalAlpha = lines.length + arrows.length > MANY_EDGES ? 0.2 : 0.55;
      pen.beginPath();
      for (const [from, to] of lines) {
        pen.moveTo(from[0], from[1]);
        pen.lineTo(to[0], to[1]);
      }
      for (const [from, to] of arrows) {
        const across = to[0] - from[0], up = to[1] - from[1], far = Math.hypot(across, up);
        if (far === 0) continue;
        const reach = Math.max(far - 0.5 * length, 0.5 * far);
        const head = Math.min(0.5 * length, 0.5 * reach);
        const x = across / far, y = up / far;
        pen.moveTo(from[0], from[1]);
        pen.lineTo(from[0] + reach * x, from[1] + reach * y);
        for (const side of [0.4, -0.4]) {
          pen.moveTo(from[0] + reach * x, from[1] + reach * y);
          pen.lineTo(from[0] + (reach - head) * x - side * head * y,
            from[1] + (reach - head) * y + side * head * x);
        }
      }
      pen.stroke();
      pen.globalAlpha = 1;
    }

    function drawBody(pen, place, heading, length, colour) {
      pen.fillStyle = colour;
      pen.beginPath();
      if (heading === null) {
        pen.arc(place[0], place[1], 0.3 * length, 0, TURN);
      } else {
        const cos = Math.cos(heading), sin = Math.sin(heading);
        for (const [along, across] of DART) {
          pen.lineTo(place[0] + length * (along * cos - across * sin),
            place[1] - length * (along * sin + across * cos));
        }
      }
      pen.fill();
    }

    function drawScale(pen, scale, ink) {
      const long = roundLength(0.25 * (right - left));
      const y = height - 10;
      pen.strokeStyle = pen.fillStyle = ink;
      pen.lineWidth = 2;
      pen.beginPath();
      pen.moveTo(10, y);
      pen.lineTo(10 + long * scale, y);
      pen.stroke();
      pen.font = "12px system-ui, sans-serif";
      pen.fillText(`${Number(long.toPrecision(1))} ${film.unit}`.trim(), 10, y - 5);
    }

    return { resize, draw };
  }

  async function start(root) {
    const film = JSON.parse(root.querySelector("script[type='application/json']").textContent);
    const part = (name) => root.querySelector(`[data-part="${name}"]`);
    const play = part("play"), scrub = part("scrub"), clock = part("clock"), speed = part("speed");
    const scenes = await Promise.all(film.scenes.map(unpack));
    const shown = { edges: true, tails: true, names: false };
    const canvases = [...root.querySelectorAll("canvas")];
    const pictures = canvases.map((canvas, place) => picture(canvas, scenes[place], film, shown));
    const last = film.frames - 1;
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    let frame = 0, playing = false, visible = true, since = 0, from = 0, told = null;

    const seconds = (at) => (film.first + at * film.step).toFixed(film.digits);
    const draw = () => pictures.forEach((one) => one.draw(frame));

    function show(at) {
      frame = at;
      scrub.value = at;
      clock.textContent = `${seconds(at)} s`;
      // Aloud only once a second while it plays.
      const words = playing ? `${Math.floor(film.first + at * film.step)} s`
        : `${seconds(at)} s, frame ${at + 1} of ${film.frames}`;
      if (words !== told) scrub.setAttribute("aria-valuetext", words);
      told = words;
      draw();
    }
    function tick(now) {
      if (!playing || !visible) return;
      const gone = Math.floor(((now - since) / 1000) * film.pace * Number(speed.value));
      const at = (from + Math.max(gone, 0)) % film.frames;
      if (at !== frame) show(at);
      requestAnimationFrame(tick);
    }
    function begin() {
      since = performance.now();
      from = frame;
      requestAnimationFrame(tick);
    }
    function set(running) {
      playing = running && last > 0;
      play.textContent = playing ? "❚❚ Pause" : "▶ Play";
      if (playing) begin();
      show(frame);
    }
    function seek(at) {
      show(Math.min(Math.max(Math.round(at), 0), last));
      since = performance.now();
      from = frame;
    }
    function onKey(event) {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      const target = event.target;
      const chooses = target.tagName === "SELECT";
      const pressed = ["BUTTON", "SUMMARY"].includes(target.tagName) || target.type === "checkbox";
      const stride = event.shiftKey ? 10 : 1;
      if (event.key === " " && !chooses && !pressed) set(!playing);
      else if (event.key === "ArrowRight" && !chooses) seek(frame + stride);
      else if (event.key === "ArrowLeft" && !chooses) seek(frame - stride);
      else if (event.key === "Home" && !chooses) seek(0);
      else if (event.key === "End" && !chooses) seek(last);
      else return;
      event.preventDefault();
    }

    play.addEventListener("click", () => set(!playing));
    scrub.addEventListener("input", () => seek(Number(scrub.value)));
    speed.addEventListener("change", () => seek(frame));
    root.addEventListener("keydown", onKey);
    if (film.page) {
      // Alone on its page, the keys are the player's wherever nothing else has them.
      document.addEventListener("keydown", (event) => {
        if (event.target === document.body) onKey(event);
      });
    }
    for (const name of Object.keys(shown)) {
      const box = part(name);
      if (box === null) continue;
      // A page that is loaded again may keep what was ticked.
      shown[name] = box.checked;
      box.addEventListener("change", () => { shown[name] = box.checked; draw(); });
    }
    for (const canvas of canvases) {
      canvas.addEventListener("click", () => { play.focus(); set(!playing); });
    }
    const fit = () => { pictures.forEach((one) => one.resize()); draw(); };
    new ResizeObserver(fit).observe(root);
    for (const query of ["(prefers-color-scheme: dark)", "print"]) {
      window.matchMedia(query).addEventListener("change", draw);
    }
    new IntersectionObserver((entries) => {
      const back = entries[entries.length - 1].isIntersecting;
      if (back && !visible && playing) { visible = true; begin(); }
      visible = back;
    }).observe(root);

    for (const control of root.querySelectorAll("[data-part]")) control.disabled = false;
    if (last === 0) play.disabled = scrub.disabled = true;
    root.player = {
      play: () => set(true),
      pause: () => set(false),
      seek,
      get frame() { return frame; },
      get playing() { return playing; },
      scenes,
    };
    fit();
    show(0);
    if (film.autoplay && !still) set(true);
    root.dataset.state = "ready";
  }

  for (const root of document.querySelectorAll(".swarm-player:not([data-state])")) {
    root.dataset.state = "loading";
    start(root).catch((error) => {
      root.dataset.state = "failed";
      root.querySelector("[data-part='clock']").textContent =
        "This browser cannot unpack the frames: it has to know DecompressionStream.";
      console.error(error);
    });
  }
})();
