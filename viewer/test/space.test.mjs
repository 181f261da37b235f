// Bodies and joints, compared with poses that can be worked out by hand.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./load.mjs";

const { place, rolled, turned, within, shifted } = await load("stage/space.ts");
const { poses } = await load("stage/pose.ts");
const { closestPair } = await load("stage/closest.ts");

const near = (actual, expected) =>
  actual.forEach((value, i) => assert.ok(Math.abs(value - expected[i]) < 1e-12, `${actual} is not ${expected}`));
const RIGHT = Math.PI / 2;

test("a right angle about each axis turns one axis into the next", () => {
  near(place(turned([0, 0, 1], RIGHT), [1, 0, 0]), [0, 1, 0]);
  near(place(turned([1, 0, 0], RIGHT), [0, 1, 0]), [0, 0, 1]);
  near(place(turned([0, 1, 0], RIGHT), [0, 0, 1]), [1, 0, 0]);
});

test("roll, pitch and yaw turn about the fixed axes in this order", () => {
  near(place(rolled([RIGHT, 0, RIGHT]), [0, 1, 0]), [0, 0, 1]);
  near(place(rolled([RIGHT, RIGHT, 0]), [0, 1, 0]), [1, 0, 0]);
  near(place(within(shifted([1, 2, 3]), rolled([0, 0, RIGHT])), [1, 0, 0]), [1, 3, 3]);
});

const fixed = (offset) => ({ device: null, scale: 1, offset });
const show = (bodies) => ({ mission: { robots: bodies.map((body) => ({ id: "", devices: [], body })) }, track: () => undefined });
const ball = (x, radius, joints = []) => ({
  x: fixed(x),
  y: fixed(0),
  z: fixed(0),
  yaw: fixed(0),
  shape: { ball: radius },
  joints,
});

test("joints carry what comes after them", () => {
  const joint = (kind, xyz, axis, value) => ({ name: "", kind, xyz, rpy: [0, 0, 0], axis, value: fixed(value), radius: 0.1 });
  const arm = {
    ...ball(1, 0.1),
    yaw: fixed(RIGHT),
    joints: [
      joint("revolute", [0, 0, 1], [0, 1, 0], RIGHT),
      joint("prismatic", [1, 0, 0], [1, 0, 0], 0.5),
      joint("fixed", [0, 0.25, 0], [0, 0, 1], 0),
    ],
  };
  const [{ chain }] = poses(show([arm]), 0);
  near(chain[0], [1, 0, 1]);
  near(chain[1], [1, 0, -0.5]);
  near(chain[2], [0.75, 0, -0.5]);
});

test("bodies are as far apart as their surfaces", () => {
  const pair = closestPair(poses(show([ball(0, 0.25), ball(2, 0.5), ball(10, 0.1)]), 0));
  assert.deepEqual(pair, { robots: [0, 1], distance: 1.25 });
  const box = { ...ball(2, 0), shape: { box: [1, 1, 1] } };
  assert.deepEqual(closestPair(poses(show([ball(0, 0.25), box]), 0)), { robots: [0, 1], distance: 1.25 });
  const turned = { ...ball(4, 0), yaw: fixed(Math.PI / 4), shape: { box: [1, 1, 1] } };
  near([closestPair(poses(show([box, turned]), 0)).distance], [2 - 0.5 - Math.SQRT1_2]);
});

test("an arm is measured at its links, as the compiler measures it", () => {
  const link = (xyz, radius) => ({ name: "", kind: "fixed", xyz, rpy: [0, 0, 0], axis: [0, 0, 1], value: fixed(0), radius });
  // A mast of 1 m with a boom of 2 m towards the ball.
  const arm = ball(0, 0, [link([0, 0, 0], 0.1), link([0, 0, 1], 0.1), link([2, 0, 0], 0.1)]);
  const drone = { ...ball(3, 0.2), z: fixed(1) };
  near([closestPair(poses(show([arm, drone]), 0)).distance], [0.7]);
});

test("a robot whose place is unknown is not measured", () => {
  const lost = { ...ball(0, 0.1), x: { device: 0, scale: 1, offset: 0 } };
  assert.equal(closestPair(poses(show([lost, ball(1, 0.1)]), 0)), null);
});

test("the distance of two parts is the least over many points of them", async () => {
  const { gap } = await load("stage/parts.ts");
  let seed = 11;
  const next = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
  const point = (by = 2) => [0, 1, 2].map(() => by * (2 * next() - 1));
  const box = () => ({ kind: "box", frame: within(shifted(point()), turned([0, 0, 1], 6 * next())), half: [0, 1, 2].map(() => 0.2 + next()) });
  const segment = () => ({ kind: "segment", a: point(), b: point() });
  const grid = Array.from({ length: 13 }, (_, i) => i / 12);
  const pointsOf = (core) =>
    core.kind === "segment"
      ? grid.map((s) => core.a.map((value, i) => value + s * (core.b[i] - value)))
      : grid.flatMap((u) => grid.flatMap((v) => grid.map((w) => place(core.frame, [u, v, w].map((s, i) => (2 * s - 1) * core.half[i])))));
  for (let i = 0; i < 24; i++) {
    const [a, b] = [[segment, segment], [segment, box], [box, box]][i % 3].map((make) => make());
    let least = Infinity;
    for (const p of pointsOf(a)) for (const q of pointsOf(b)) least = Math.min(least, Math.hypot(...p.map((value, k) => value - q[k])));
    const found = gap({ core: a, radius: 0 }, { core: b, radius: 0 });
    // The grid is at most 0.35 m wide in each part.
    assert.ok(found <= least + 1e-9 && found > least - 0.35, `${i}: ${found} is not ${least}`);
  }
});
