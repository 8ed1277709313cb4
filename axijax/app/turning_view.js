// Turns the specimen of a report by pointer, touch or arrow keys: spheres drawn from the back to the front on a canvas.
// Each figure.turning holds its balls in its data; nothing is fetched, and without this script the figure stays hidden.
"use strict";
for (const figure of document.querySelectorAll("figure.turning")) {
  const seen = JSON.parse(figure.dataset.seen);
  const numbers = (text, Kind) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new Kind(bytes.buffer);
  };
  const place = numbers(seen.place, Int16Array), radius = numbers(seen.radius, Int16Array);
  const count = radius.length, reach = seen.reach, half = seen.height / 2; // lengths in units of their own
  const fields = seen.fields.map((each) => ({ ...each, values: numbers(each.values, Uint8Array) }));
  const canvas = figure.querySelector("canvas"), pen = canvas.getContext("2d");
  const choice = figure.querySelector("select"), cut = figure.querySelector("input");
  const scale = figure.querySelector(".scale"), told = figure.querySelector("output");
  const depth = new Float32Array(count), across = new Float32Array(count), up = new Float32Array(count);
  const order = new Uint32Array(count), fingers = new Map();
  let { turn, rise } = seen, zoom = 1, shown = 0, size = 1, field, balls, waiting = false;

  // One shaded ball of each colour, to be drawn in every size.
  const ball = (colour) => {
    const made = document.createElement("canvas");
    made.width = made.height = 96;
    const brush = made.getContext("2d");
    brush.beginPath();
    brush.arc(48, 48, 47, 0, 2 * Math.PI);
    brush.fillStyle = colour;
    brush.fill();
    const light = brush.createRadialGradient(34, 30, 3, 48, 48, 50);
    light.addColorStop(0, "rgba(255,255,255,.65)");
    light.addColorStop(0.35, "rgba(255,255,255,.12)");
    light.addColorStop(0.7, "rgba(0,0,0,.08)");
    light.addColorStop(1, "rgba(0,0,0,.55)");
    brush.fillStyle = light;
    brush.fill();
    return made;
  };

  const choose = () => {
    field = fields[choice.value];
    balls = field.colours.map(ball);
    const steps = field.colours, names = field.told.map((name) => `<span>${name}</span>`);
    scale.innerHTML = field.kinds
      ? names.map((name, k) => name.replace(">", `><i style="background:${steps[k]}"></i>`)).join("")
      : `${names[0]}<i style="background:linear-gradient(90deg,${steps.join()})"></i>${names.at(-1)}`;
    told.textContent = "";
    later();
  };

  const rim = (height, colour, fill) => {
    pen.beginPath();
    for (let k = 0; k <= 90; k++) {
      const angle = (k * seen.span) / 90, x = reach * Math.cos(angle), y = reach * Math.sin(angle);
      pen.lineTo(...onScreen(x, y, height));
    }
    if (seen.span < 6) pen.lineTo(...onScreen(0, 0, height));
    pen.closePath();
    pen.globalAlpha = fill;
    pen.fillStyle = pen.strokeStyle = colour;
    pen.fill();
    pen.globalAlpha = 1;
    pen.stroke();
  };

  let onScreen; // of a place: pixels to the right and down
  const draw = () => {
    waiting = false;
    const dense = window.devicePixelRatio || 1, wide = canvas.clientWidth, high = canvas.clientHeight;
    if (canvas.width !== Math.round(wide * dense) || canvas.height !== Math.round(high * dense)) {
      canvas.width = Math.round(wide * dense);
      canvas.height = Math.round(high * dense);
    }
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    pen.clearRect(0, 0, wide, high);
    const [cos, sin, lift, fall] = [Math.cos(turn), Math.sin(turn), Math.cos(rise), Math.sin(rise)];
    // Fits in every direction of view, so that nothing grows and shrinks as it turns.
    size = zoom * Math.min(wide / (2.04 * reach), high / (2.04 * Math.hypot(reach, half)));
    onScreen = (x, y, z) => {
      const towards = x * cos + y * sin;
      return [wide / 2 + size * (y * cos - x * sin), high / 2 - size * (z * lift - towards * fall)];
    };
    shown = 0;
    for (let k = 0; k < count; k++) {
      const x = place[3 * k], y = place[3 * k + 1], z = place[3 * k + 2];
      if (cut?.checked && x * seen.front[0] + y * seen.front[1] > 0.3 * radius[k]) continue;
      [across[k], up[k]] = onScreen(x, y, z);
      depth[k] = (x * cos + y * sin) * lift + z * fall;
      order[shown++] = k;
    }
    const back = order.subarray(0, shown).sort((a, b) => depth[a] - depth[b]);
    const colour = getComputedStyle(figure).color;
    const [near, far] = fall >= 0 ? [half, -half] : [-half, half];
    rim(far, colour, 0.12);
    for (const k of back) {
      const wide = size * radius[k];
      pen.drawImage(balls[field.values[k]], across[k] - wide, up[k] - wide, 2 * wide, 2 * wide);
    }
    rim(near, colour, 0.06);
  };
  const later = () => {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  };

  // The ball in front under a point: what it is and has.
  const point = (event) => {
    const box = canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
    for (let k = shown - 1; k >= 0; k--) {
      const which = order[k];
      if (Math.hypot(across[which] - x, up[which] - y) > size * radius[which]) continue;
      told.textContent = `ball ${seen.number[which]}: ${field.told[field.values[which]]}`;
      return;
    }
    told.textContent = "";
  };

  const tilt = (by) => (rise = Math.max(-1.5, Math.min(1.5, rise + by)));
  const apart = () => {
    const [one, two] = [...fingers.values()];
    return Math.hypot(one.clientX - two.clientX, one.clientY - two.clientY);
  };
  canvas.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, event);
    canvas.setPointerCapture(event.pointerId);
    if (fingers.size === 1) point(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const wide = fingers.size === 2 ? apart() : 0;
    fingers.set(event.pointerId, event);
    if (fingers.size === 2) zoom = Math.max(0.5, Math.min(8, (zoom * apart()) / Math.max(wide, 1)));
    else {
      turn -= (event.clientX - before.clientX) / 120;
      tilt((event.clientY - before.clientY) / 120);
    }
    later();
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  const keys = {
    ArrowLeft: () => (turn += 0.1), ArrowRight: () => (turn -= 0.1), ArrowUp: () => tilt(-0.1), ArrowDown: () => tilt(0.1),
    "+": () => (zoom = Math.min(8, zoom * 1.2)), "-": () => (zoom = Math.max(0.5, zoom / 1.2)),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key]) return;
    keys[event.key]();
    event.preventDefault();
    later();
  });
  choice.addEventListener("change", choose);
  cut?.addEventListener("change", later);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", later);
  figure.hidden = false;
  new ResizeObserver(later).observe(canvas);
  choose();
}
