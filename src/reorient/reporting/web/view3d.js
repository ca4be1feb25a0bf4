"use strict";
// The 3D view of a pair: both clouds, a hypothesis between them, the other hypotheses as ghosts, axis, camera, belief.

const CLOUDS = { goal: [86, 180, 233], current: [230, 159, 0] };
const GHOST = [204, 121, 167];
const LINES = { axis: "#ffffff", camera: "#aeb6c4", belief: "#cc79a7" };
const percent = (share) => (share === null || share === undefined ? "–" : `${Math.min(100 * share, 99.9).toFixed(1)}%`);
let views = 0;

class View {
  constructor(classes, onHypothesis = () => {}) {
    const id = `view${++views}`;
    this.classes = classes;
    this.onHypothesis = onHypothesis;
    this.canvas = element("canvas", {
      tabindex: 0, role: "application", "aria-roledescription": "3D view", "aria-describedby": `${id}-read`,
      "aria-label": "Both images as points in space. Arrow keys rotate, plus and minus zoom, 0 resets.",
      onkeydown: (event) => this.key(event), onpointerdown: (event) => (this.pressed = [event.clientX, event.clientY]),
      onpointerup: (event) => this.pick(event),
    });
    this.legend = element("ul", { class: "legend" });
    this.slider = element("input", {
      type: "range", min: 0, max: 100, value: 100, id: `${id}-align`, "aria-label": "from as captured to aligned",
      oninput: () => this.move(),
    });
    this.colour = element("select", { id: `${id}-colour`, onchange: () => this.recolour() },
      element("option", { value: "evidence" }, "evidence"), element("option", { value: "image" }, "image"));
    const box = (name, checked) => element("label", { class: "check" },
      (this[`show_${name}`] = element("input", { type: "checkbox", checked, onchange: () => this.toggle() })), name);
    this.boxes = element("div", { class: "row" }, box("goal", true), box("current", true), box("axis", true),
      box("alternatives", true), box("camera", false), box("belief", false));
    this.choices = element("fieldset", { class: "choices" });
    this.read = element("p", { class: "read", id: `${id}-read`, "aria-live": "polite" });
    this.beliefs = element("div", { class: "beliefs" });
    this.plate = element("div", { class: "plate" }, this.canvas, this.legend);
    this.root = element("div", { class: "view" }, this.plate, element("div", { class: "controls" },
      element("div", { class: "field" }, element("span", { class: "ends" }, element("span", {}, "as captured"), element("span", {}, "aligned")), this.slider),
      element("div", { class: "row" }, element("label", { for: `${id}-colour` }, "colour by "), this.colour,
        element("button", { type: "button", onclick: () => this.reset() }, "reset view")),
      this.boxes, this.choices, this.read, this.beliefs));
    this.start();
  }

  start() {
    try {
      this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true, preserveDrawingBuffer: true });
    } catch (error) {
      this.plate.replaceChildren(element("p", { class: "nothing" }, "This browser offers no WebGL, so there is no 3D view. All images and numbers are below."));
      return;
    }
    this.renderer.setClearColor(0x14171c);
    this.scene = new THREE.Scene();
    this.world = new THREE.Group(); // camera axes; three.js has y up and z towards the eye
    this.world.rotation.x = Math.PI;
    this.scene.add(this.world);
    this.eye = new THREE.PerspectiveCamera(32, 1, 0.001, 100);
    this.orbit = new THREE.OrbitControls(this.eye, this.canvas);
    this.orbit.addEventListener("change", () => this.draw());
    new ResizeObserver(() => this.resize()).observe(this.plate);
  }

  // pair: {goal, current} decoded images, hypotheses, belief. The eye stays where it is while the goal stays.
  async show(pair) {
    this.pair = pair;
    this.chosen = 0;
    for (const each of pair.hypotheses) each.parts ??= each.classes ? await Promise.all(each.classes.map(unpacked)) : null;
    if (!pair.hypotheses.some((each) => each.parts)) this.colour.value = "image";
    this.colour.disabled = !pair.hypotheses.some((each) => each.parts);
    this.show_alternatives.parentElement.hidden = pair.hypotheses.length < 2;
    this.show_belief.parentElement.hidden = !(pair.belief || []).length;
    if (this.renderer) this.build();
    this.list();
    this.choose(0, false);
  }

  build() {
    const { goal, current } = this.pair, middle = centre(goal.points), fresh = this.goal !== goal;
    this.goal = goal;
    this.middle = centre(current.points);
    this.world.clear();
    this.radius = Math.max(reach(goal.points, middle), reach(current.points, this.middle));
    this.clouds = { goal: cloud(goal, CLOUDS.goal), current: cloud(current, CLOUDS.current) };
    this.ghosts = new THREE.Group();
    this.lines = new THREE.Group();
    this.world.add(this.clouds.goal, this.clouds.current, this.ghosts, this.lines);
    this.frustum = frustum(goal);
    this.world.add(this.frustum);
    this.needles = needles(this.pair.belief || [], middle, this.radius);
    this.world.add(this.needles);
    this.target = middle;
    if (fresh) this.reset();
  }

  list() {
    const name = `choice${views}${Math.random()}`;
    this.choices.replaceChildren(element("legend", {}, "Hypotheses"), ...this.pair.hypotheses.map((each, index) =>
      element("label", { class: "check" },
        element("input", { type: "radio", name, value: index, checked: index === 0, onchange: () => this.choose(index) }),
        `${each.label}: ${each.angle_deg.toFixed(2)}°` + (each.probability === null || each.probability === undefined ? "" : `, ${percent(each.probability)}`) + (each.note ? `, ${each.note}` : ""))));
    const belief = this.pair.belief || [];
    this.beliefs.replaceChildren(...(belief.length ? [element("h3", {}, "Belief"), element("ul", {}, ...belief.slice(0, 6).map((each) =>
      element("li", {}, element("meter", { min: 0, max: 1, value: each.probability, "aria-label": `probability of ${each.angle_deg.toFixed(1)} degrees` }),
        ` ${percent(each.probability)}: ${each.angle_deg.toFixed(1)}° remaining`)))] : []));
  }

  choose(index, tell = true) {
    this.chosen = index;
    const each = this.pair.hypotheses[index], [x, y, z] = each.axis.map((value) => value.toFixed(2));
    this.choices.querySelectorAll("input")[index].checked = true;
    this.read.textContent = `${each.label}: rotation by ${each.angle_deg.toFixed(2)}° about [${x} ${y} ${z}] (camera axes: x right, y down, z forward)` +
      (each.probability === null || each.probability === undefined ? "" : `; probability ${percent(each.probability)}`) +
      (each.shares ? `; inliers ${(100 * each.shares[0]).toFixed(0)}%, occluded ${(100 * each.shares[3]).toFixed(0)}%` : "") + ".";
    if (this.renderer) {
      this.lines.clear();
      this.lines.add(axisOf(each, this.target, this.radius));
      this.ghosts.clear();
      this.pair.hypotheses.forEach((other, k) => k !== index && this.ghosts.add(this.ghost(other, k)));
      this.recolour();
    } else this.describe();
    if (tell) this.onHypothesis(index);
  }

  ghost(hypothesis, index) {
    const others = this.pair.hypotheses.length - 1, place = index > this.chosen ? index - 1 : index, scale = 0.42;
    const points = new THREE.Points(this.clouds.current.geometry.clone(), this.clouds.current.material.clone());
    paint(points, this.pair.current, () => GHOST);
    points.material.size *= scale;
    const inside = new THREE.Group(), ghost = new THREE.Group(), shift = motion(hypothesis);
    inside.matrixAutoUpdate = false;
    inside.matrix.copy(shift);
    inside.add(points);
    const moved = this.middle.clone().applyMatrix4(shift);
    ghost.add(inside, new THREE.Mesh(new THREE.SphereGeometry(this.radius, 12, 8), new THREE.MeshBasicMaterial({ visible: false })));
    ghost.children[1].position.copy(moved);
    ghost.children[1].userData.index = index;
    ghost.scale.setScalar(scale);
    const to = this.target.clone().add(new THREE.Vector3(1.75 * this.radius, (place - (others - 1) / 2) * 0.95 * this.radius, 0));
    ghost.position.copy(to.sub(moved.multiplyScalar(scale)));
    return ghost;
  }

  recolour() {
    if (!this.renderer) return;
    const hypothesis = this.pair.hypotheses[this.chosen], evidence = this.colour.value === "evidence" && hypothesis.parts;
    ["current", "goal"].forEach((name, side) =>
      paint(this.clouds[name], this.pair[name], (k) => (evidence ? this.classes[hypothesis.parts[side][k]].colour : CLOUDS[name])));
    this.describe();
    this.move();
  }

  describe() {
    const hypothesis = this.pair.hypotheses[this.chosen], evidence = this.colour.value === "evidence" && hypothesis.parts;
    const items = evidence
      ? this.classes.map((each, k) => [each.colour, `${each.label} ${(100 * hypothesis.shares[k]).toFixed(0)}%`])
      : [[CLOUDS.goal, "goal"], [CLOUDS.current, "current"]];
    if (this.pair.hypotheses.length > 1 && this.show_alternatives.checked) items.push([GHOST, "alternatives (click)"]);
    this.legend.replaceChildren(...items.map(([colour, label]) =>
      element("li", {}, element("span", { class: "swatch", style: `background:rgb(${colour})` }), label)));
  }

  // The current cloud on its way: rotated about its middle by a share of the angle, its middle moved as far.
  move() {
    const share = this.slider.value / 100, hypothesis = this.pair.hypotheses[this.chosen];
    this.slider.setAttribute("aria-valuetext", share === 0 ? "as captured" : share === 1 ? "aligned" : `${Math.round(100 * share)}% of the motion`);
    if (!this.renderer) return;
    const whole = motion(hypothesis), end = this.middle.clone().applyMatrix4(whole);
    const axis = new THREE.Vector3(...hypothesis.axis), turn = new THREE.Quaternion().setFromAxisAngle(axis, (share * hypothesis.angle_deg * Math.PI) / 180);
    const at = this.middle.clone().lerp(end, share).sub(this.middle.clone().applyQuaternion(turn));
    const { current } = this.clouds;
    current.matrixAutoUpdate = false;
    current.matrix.compose(at, turn, new THREE.Vector3(1, 1, 1));
    this.toggle();
  }

  toggle() {
    this.describe();
    if (!this.renderer) return;
    this.clouds.goal.visible = this.show_goal.checked;
    this.clouds.current.visible = this.show_current.checked;
    this.lines.visible = this.show_axis.checked;
    this.ghosts.visible = this.show_alternatives.checked;
    this.frustum.visible = this.show_camera.checked;
    this.needles.visible = this.show_belief.checked;
    this.draw();
  }

  reset() {
    if (!this.renderer || !this.target) return;
    const target = this.target.clone().applyEuler(this.world.rotation), many = this.pair.hypotheses.length > 1;
    const far = (many ? 5.4 : 4.4) * this.radius;
    this.orbit.target.copy(target);
    if (many) this.orbit.target.x += 0.5 * this.radius;
    this.eye.position.copy(this.orbit.target).add(new THREE.Vector3(0.35, 0.35, 1).normalize().multiplyScalar(far));
    this.eye.near = far / 100;
    this.eye.far = 60 * far;
    this.resize();
    this.orbit.update();
  }

  resize() {
    const width = this.plate.clientWidth, height = this.plate.clientHeight;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.eye.aspect = width / height;
    this.eye.fov = width < height ? 2 * Math.atan((Math.tan((16 * Math.PI) / 180) * height) / width) * (180 / Math.PI) : 32;
    this.eye.updateProjectionMatrix();
    this.draw();
  }

  draw() {
    this.renderer.render(this.scene, this.eye);
  }

  key(event) {
    if (!this.renderer) return;
    const turn = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, -0.15], ArrowDown: [0, 0.15] }[event.key];
    const offset = this.eye.position.clone().sub(this.orbit.target);
    if (turn) {
      const side = new THREE.Vector3(1, 0, 0).applyQuaternion(this.eye.quaternion);
      offset.applyAxisAngle(new THREE.Vector3(0, 1, 0), turn[0]).applyAxisAngle(side, turn[1]);
    } else if (event.key === "+" || event.key === "=") offset.multiplyScalar(0.87);
    else if (event.key === "-") offset.multiplyScalar(1.15);
    else if (event.key === "0") return this.reset();
    else return;
    event.preventDefault();
    this.eye.position.copy(this.orbit.target).add(offset);
    this.orbit.update();
  }

  pick(event) {
    if (!this.renderer || !this.pressed || Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) > 4) return;
    const box = this.canvas.getBoundingClientRect(), ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height), this.eye);
    const hit = ray.intersectObjects(this.ghosts.visible ? this.ghosts.children.map((ghost) => ghost.children[1]) : []);
    if (hit.length) this.choose(hit[0].object.userData.index);
  }
}

function motion({ R, t_m: t }) {
  return new THREE.Matrix4().set(R[0], R[1], R[2], t[0], R[3], R[4], R[5], t[1], R[6], R[7], R[8], t[2], 0, 0, 0, 1);
}

function centre(points) {
  const sum = [0, 0, 0];
  points.forEach((value, i) => (sum[i % 3] += value));
  return new THREE.Vector3(...sum.map((value) => (3 * value) / points.length));
}

function reach(points, middle) {
  let most = 0;
  for (let i = 0; i < points.length; i += 3) most = Math.max(most, (points[i] - middle.x) ** 2 + (points[i + 1] - middle.y) ** 2 + (points[i + 2] - middle.z) ** 2);
  return Math.sqrt(most);
}

function cloud(image, colour) {
  const geometry = new THREE.BufferGeometry(), size = (4.9 * image.near) / image.fx; // of three.js, which leaves out the field of view
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(image.points, 3));
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(new Float32Array(image.points.length), 3));
  const points = new THREE.Points(geometry, new THREE.PointsMaterial({ size, vertexColors: true, toneMapped: false }));
  paint(points, image, () => colour);
  return points;
}

function paint(points, image, colourOf) {
  const colours = points.geometry.getAttribute("color");
  for (let k = 0; k < image.light.length; k++) {
    const shade = Math.min(0.35 + 0.75 * image.light[k], 1.1);
    colours.setXYZ(k, ...colourOf(k).map((value) => Math.min((value / 255) * shade, 1) ** 2.2));
  }
  colours.needsUpdate = true;
}

function strokes(ends, colour) {
  const geometry = new THREE.BufferGeometry().setFromPoints(ends);
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: colour, toneMapped: false }));
}

// The axis of a rotation with an arrowhead, and an arc of its angle about it.
function axisOf({ axis, angle_deg: angle }, middle, radius) {
  const group = new THREE.Group(), along = new THREE.Vector3(...axis), end = middle.clone().addScaledVector(along, 1.35 * radius);
  group.add(strokes([middle.clone().addScaledVector(along, -1.35 * radius), end], LINES.axis));
  const head = new THREE.Mesh(new THREE.ConeGeometry(0.05 * radius, 0.16 * radius, 16), new THREE.MeshBasicMaterial({ color: LINES.axis }));
  head.position.copy(end);
  head.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along);
  group.add(head);
  const across = new THREE.Vector3(Math.abs(axis[0]) < 0.7 ? 1 : 0, Math.abs(axis[0]) < 0.7 ? 0 : 1, 0).cross(along).setLength(0.3 * radius);
  const base = middle.clone().addScaledVector(along, 1.1 * radius), arc = [];
  const steps = Math.max(Math.ceil(angle / 4), 1);
  for (let k = 0; k < steps; k++) for (const share of [k, k + 1]) arc.push(base.clone().add(across.clone().applyAxisAngle(along, ((share / steps) * angle * Math.PI) / 180)));
  group.add(strokes(arc, LINES.axis));
  return group;
}

// The pyramid that the camera sees, and its axes: x vermillion, y green, z blue.
function frustum({ width, height, fx, fy, cx, cy, near }) {
  const group = new THREE.Group(), origin = new THREE.Vector3(), z = 0.85 * near;
  const corners = [[0, 0], [width, 0], [width, height], [0, height]].map(([u, v]) => new THREE.Vector3(((u - cx) / fx) * z, ((v - cy) / fy) * z, z));
  group.add(strokes(corners.flatMap((corner, k) => [origin, corner, corner, corners[(k + 1) % 4]]), LINES.camera));
  [[1, 0, 0, "#d55e00"], [0, 1, 0, "#009e73"], [0, 0, 1, "#56b4e9"]].forEach(([x, y, zz, colour]) => group.add(strokes([origin, new THREE.Vector3(x, y, zz).multiplyScalar(0.2 * near)], colour)));
  return group;
}

// Each hypothesis of the belief as a line from the middle along its axis, as long as its angle is large.
function needles(belief, middle, radius) {
  const group = new THREE.Group();
  for (const each of belief) {
    const end = middle.clone().addScaledVector(new THREE.Vector3(...each.axis), (1.4 * radius * (each.angle_deg + 5)) / 185);
    group.add(strokes([middle, end], LINES.belief));
    const tip = new THREE.Mesh(new THREE.SphereGeometry(radius * (0.02 + 0.07 * each.probability), 12, 8), new THREE.MeshBasicMaterial({ color: LINES.belief }));
    tip.position.copy(end);
    group.add(tip);
  }
  return group;
}
