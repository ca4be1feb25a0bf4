"use strict";
// Depth images: decoding, normals, shading on a canvas. Camera axes: x right, y down, z forward; metres.

const NEAR_TO_FAR = [[255, 226, 178], [244, 176, 132], [196, 132, 150], [112, 118, 176], [62, 92, 150]];
const PLATE = [24, 27, 33], UNKNOWN = [230, 159, 0];

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The image with its depth (0: not the object, -1: unknown), and for each return in row order place and light.
async function decoded(image) {
  if (image.decoded) return image.decoded;
  const { width, height, near_m: near, step_m: step } = image, n = width * height;
  const bytes = await unpacked(image.data), depth = new Float32Array(n);
  for (let row = 0, i = 0; row < height; row++) {
    for (let column = 0, sum = 0; column < width; column++, i++) {
      sum = (sum + bytes[i] + 256 * bytes[n + i]) & 0xffff;
      depth[i] = sum > 1 ? near + step * (sum - 2) : -sum;
    }
  }
  const [fx, fy, cx, cy] = image.camera, places = new Int32Array(image.seen), points = new Float32Array(3 * image.seen);
  let far = near, k = 0;
  for (let i = 0; i < n; i++) {
    if (depth[i] <= 0) continue;
    const z = depth[i];
    far = Math.max(far, z);
    places[k] = i;
    points.set([(((i % width) + 0.5 - cx) * z) / fx, ((Math.floor(i / width) + 0.5 - cy) * z) / fy, z], 3 * k++);
  }
  image.decoded = { width, height, fx, fy, cx, cy, depth, places, points, near, far, light: lights(depth, width, height, fx, fy, places) };
  return image.decoded;
}

// Brightness of each return under two lights; the surface is smoothed, as single depths are noisy.
function lights(depth, width, height, fx, fy, places) {
  const smooth = new Float32Array(depth.length);
  for (const i of places) {
    let sum = 0, weight = 0;
    const z = depth[i];
    for (let dy = -2; dy <= 2; dy++) {
      for (let dx = -2; dx <= 2; dx++) {
        const x = (i % width) + dx, j = i + dy * width + dx;
        if (x < 0 || x >= width || j < 0 || j >= depth.length || depth[j] <= 0) continue;
        if (Math.abs(depth[j] - z) > (8 * z) / fx) continue;
        const w = 1 / (1 + dx * dx + dy * dy);
        sum += w * depth[j];
        weight += w;
      }
    }
    smooth[i] = sum / weight;
  }
  const slope = (i, step, focal) => {
    const z = smooth[i], near = (j) => j >= 0 && j < smooth.length && smooth[j] > 0 && Math.abs(smooth[j] - z) < (8 * z) / focal;
    const after = near(i + step), before = near(i - step);
    const difference = (after ? smooth[i + step] : z) - (before ? smooth[i - step] : z);
    return (difference * focal) / (z * Math.max(after + before, 1));
  };
  return Float32Array.from(places, (i) => {
    const a = slope(i, 1, fx), b = slope(i, width, fy), length = Math.hypot(a, b, 1);
    const n = [a / length, b / length, -1 / length];
    const key = Math.max(-0.46 * n[0] - 0.628 * n[1] - 0.628 * n[2], 0);
    const fill = Math.max(0.868 * n[0] + 0.145 * n[1] - 0.482 * n[2], 0);
    return 0.3 + 0.72 * key + 0.24 * fill;
  });
}

const mixed = (stops, share) => {
  const at = Math.min(Math.max(share, 0), 1) * (stops.length - 1), k = Math.min(Math.floor(at), stops.length - 2);
  return stops[k].map((value, channel) => value + (at - k) * (stops[k + 1][channel] - value));
};

// A canvas with the shaded image: warm near, cold far, dark without the object, striped where unknown.
function drawn(image, label, near = image.near, far = image.far) {
  const { width, height, depth, places, light } = image;
  const canvas = element("canvas", { width, height, role: "img", "aria-label": label });
  const context = canvas.getContext("2d"), pixels = context.createImageData(width, height);
  for (let i = 0; i < depth.length; i++) {
    const stripe = depth[i] < 0 && ((i % width) + Math.floor(i / width)) % 4 < 2;
    pixels.data.set([...(stripe ? UNKNOWN.map((value) => 0.75 * value) : PLATE), 255], 4 * i);
  }
  places.forEach((i, k) => {
    const tint = mixed(NEAR_TO_FAR, (depth[i] - near) / Math.max(far - near, 1e-9));
    for (let channel = 0; channel < 3; channel++) pixels.data[4 * i + channel] = Math.min(tint[channel] * light[k], 255);
  });
  context.putImageData(pixels, 0, 0);
  return canvas;
}

const described = (image) =>
  `${image.seen.toLocaleString("en")} pixels of the object` +
  (image.unknown ? `, ${image.unknown.toLocaleString("en")} unknown pixels (striped)` : "");
