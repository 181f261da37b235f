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

test("balls are as far apart as their surfaces, and anything else as its centres", () => {
  const pair = closestPair(poses(show([ball(0, 0.25), ball(2, 0.5), ball(10, 0.1)]), 0));
  assert.deepEqual(pair, { robots: [0, 1], distance: 1.25, betweenCentres: false, certain: true });
  const box = { ...ball(2, 0), shape: { box: [1, 1, 1] } };
  assert.deepEqual(closestPair(poses(show([ball(0, 0.25), box]), 0)), {
    robots: [0, 1],
    distance: 2,
    betweenCentres: true,
    certain: true,
  });
});
