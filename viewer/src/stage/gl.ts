// Draws scenes with WebGL: instanced solids, lines, beams, and lights that glow.
import { Geometry, Mesh, Program, Renderer, type OGLRenderingContext } from "ogl";
import { matrixOf, type Camera } from "./camera";
import { brightened, type Beam, type Glow, type Scene, type Solid } from "./scene";
import type { Point } from "./space";

const SOLID = {
  vertex: `
    attribute vec3 position; attribute vec3 normal; attribute mat4 model; attribute vec4 tint;
    uniform mat4 view; varying vec3 vNormal; varying vec4 vTint;
    void main() {
      vNormal = normalize(mat3(model) * normal);
      vTint = tint;
      gl_Position = view * model * vec4(position, 1.0);
    }`,
  fragment: `
    precision mediump float; varying vec3 vNormal; varying vec4 vTint;
    void main() {
      float sun = max(0.0, dot(normalize(vNormal), normalize(vec3(0.3, -0.5, 0.8))));
      gl_FragColor = vec4(vTint.rgb * (0.45 + 0.6 * sun), vTint.a);
    }`,
};

/** More bodies are drawn with fewer triangles and without smooth edges, so that they move fluently without a graphics card. */
const MANY = 60;
/** Radius in pixels. */
const SMALLEST = 2;

const LINE = {
  vertex: `
    attribute vec3 position; attribute vec4 tint; uniform mat4 view; varying vec4 vTint;
    void main() { vTint = tint; gl_Position = view * vec4(position, 1.0); }`,
  fragment: `precision mediump float; varying vec4 vTint; void main() { gl_FragColor = vTint; }`,
};

// The core of a light is in front of the body around it, but behind other bodies.
const GLOW = {
  vertex: `
    attribute vec3 position; attribute vec4 tint; attribute float radius;
    uniform mat4 view; uniform float focal; uniform float sharpness; varying vec3 vTint;
    void main() {
      vec4 spot = view * vec4(position, 1.0);
      float size = clamp(radius * focal / spot.w * 9.0, 20.0, 150.0);
      vTint = tint.rgb;
      gl_Position = spot;
      gl_Position.z -= tint.a * spot.w * 0.002 + radius * 0.02;
      gl_PointSize = size * sharpness;
    }`,
  fragment: `
    precision mediump float; varying vec3 vTint;
    void main() {
      float away = 2.0 * length(gl_PointCoord - 0.5);
      float core = smoothstep(0.30, 0.14, away);
      float halo = exp(-5.0 * away * away) * (1.0 - smoothstep(0.7, 1.0, away));
      gl_FragColor = vec4(mix(vTint, vec3(1.0), 0.55 * core) * core + vTint * halo * 0.6, 1.0);
    }`,
};

const BEAM = {
  vertex: `
    attribute vec3 position; attribute vec4 tint; uniform mat4 view; varying vec4 vTint;
    void main() { vTint = tint; gl_Position = view * vec4(position, 1.0); }`,
  fragment: `precision mediump float; varying vec4 vTint; void main() { gl_FragColor = vec4(vTint.rgb * vTint.a, 1.0); }`,
};

export class Painter {
  private readonly renderer: Renderer;
  private readonly gl: OGLRenderingContext;
  private readonly shapes: Record<Shape, Instances>;
  private readonly lines: Batch;
  private readonly glows: Batch;
  private readonly beams: Batch;

  /** `null` if the browser has no WebGL. `bodies`: how many bodies will be drawn. */
  static on(canvas: HTMLCanvasElement, bodies: number): Painter | null {
    const many = bodies > MANY;
    // The renderer would report a failure on the console.
    const context = canvas.getContext("webgl2", { alpha: false, antialias: !many, depth: true });
    return context === null ? null : new Painter(canvas, many);
  }

  private constructor(canvas: HTMLCanvasElement, many: boolean) {
    this.renderer = new Renderer({ canvas, antialias: !many });
    this.gl = this.renderer.gl;
    const solid = new Program(this.gl, { ...SOLID, uniforms: { view: { value: [] } }, cullFace: false, transparent: true });
    this.shapes = {
      ball: new Instances(this.gl, solid, ballShape(many ? 5 : 10, many ? 8 : 16)),
      box: new Instances(this.gl, solid, boxShape()),
      tube: new Instances(this.gl, solid, tubeShape()),
    };
    this.lines = new Batch(this.gl, LINE, this.gl.LINES, false);
    this.glows = new Batch(this.gl, GLOW, this.gl.POINTS, true);
    this.beams = new Batch(this.gl, BEAM, this.gl.TRIANGLES, true);
  }

  draw(scene: Scene, camera: Camera, width: number, height: number, ground: string): void {
    const sharpness = Math.min(window.devicePixelRatio || 1, 2);
    if (this.renderer.width !== width || this.renderer.height !== height || this.renderer.dpr !== sharpness) {
      this.renderer.dpr = sharpness;
      this.renderer.setSize(width, height);
      // The style sheet sets the size on the page.
      this.gl.canvas instanceof HTMLCanvasElement && this.gl.canvas.removeAttribute("style");
    }
    const [red, green, blue] = parsed(ground);
    this.gl.clearColor(red, green, blue, 1);
    this.renderer.setViewport(width * sharpness, height * sharpness);
    this.renderer.bindFramebuffer();
    this.gl.disable(this.gl.SCISSOR_TEST);
    this.renderer.enable(this.gl.DEPTH_TEST);
    this.renderer.setDepthMask(true);
    this.gl.clear(this.gl.COLOR_BUFFER_BIT | this.gl.DEPTH_BUFFER_BIT);
    const view = matrixOf(camera, width, height);
    const focal = camera.map ? Math.min(width, height) / 2 / camera.reach : (Math.min(width, height) / 2) * 4;
    this.drawSolids(scene, view, Math.min(width, height) / 2 / camera.reach);
    this.drawLines(scene, view);
    this.beams.draw(view, beamData(scene.beams), focal, sharpness);
    this.glows.draw(view, glowData(scene.glows), focal, sharpness);
  }

  /** A lit body of a pixel or less is hidden in its own light. */
  private drawSolids({ solids, glows }: Scene, view: number[], scale: number): void {
    const lit = new Set(glows.map(({ robot }) => robot));
    const models: Record<Shape, number[]> = { ball: [], box: [], tube: [] };
    const tints: Record<Shape, number[]> = { ball: [], box: [], tube: [] };
    const add = (shape: Shape, model: number[], solid: Solid) => {
      models[shape].push(...model);
      tints[shape].push(...solid.colour, solid.hollow ? 0.35 : 1);
    };
    for (const solid of solids) {
      if (solid.kind === "ball" && solid.radius * scale < SMALLEST && lit.has(solid.robot)) continue;
      if (solid.kind === "ball") add("ball", scaledAt(solid.at, solid.radius), solid);
      else if (solid.kind === "box") add("box", boxAt(solid.frame.rows, solid.frame.origin, solid.size), solid);
      else {
        add("ball", scaledAt(solid.from, solid.radius), solid);
        add("ball", scaledAt(solid.to, solid.radius), solid);
        add("tube", tubeAt(solid.from, solid.to, solid.radius), solid);
      }
    }
    for (const shape of SHAPES) this.shapes[shape].draw(view, models[shape], tints[shape]);
  }

  private drawLines({ lines }: Scene, view: number[]): void {
    const data: Data = { position: [], tint: [], radius: [] };
    for (const { points, colour, alpha } of lines)
      for (let i = 0; i + 1 < points.length; i++) {
        const [from, to] = [points[i], points[i + 1]];
        if (from === null || to === null) continue;
        data.position.push(...from, ...to);
        data.tint.push(...colour, alpha, ...colour, alpha);
      }
    this.lines.draw(view, data, 1, 1);
  }
}

type Shape = "ball" | "box" | "tube";
const SHAPES: Shape[] = ["ball", "box", "tube"];
interface Vertices { position: number[]; normal: number[]; index: number[] }
interface Data { position: number[]; tint: number[]; radius: number[] }

/** A shape that is drawn many times, each with its own place and colour. */
class Instances {
  private mesh: Mesh | null = null;
  private room = 0;

  constructor(
    private readonly gl: OGLRenderingContext,
    private readonly program: Program,
    private readonly shape: Vertices,
  ) {}

  draw(view: number[], models: number[], tints: number[]): void {
    const count = models.length / 16;
    if (count === 0) return;
    const mesh = this.sized(count);
    const { model, tint } = mesh.geometry.attributes;
    (model.data as Float32Array).set(models);
    (tint.data as Float32Array).set(tints);
    model.needsUpdate = tint.needsUpdate = true;
    mesh.geometry.instancedCount = count;
    this.program.uniforms.view.value = view;
    mesh.draw();
  }

  private sized(count: number): Mesh {
    if (this.mesh !== null && count <= this.room) return this.mesh;
    this.room = Math.max(16, 2 * count);
    const geometry = new Geometry(this.gl, {
      position: { size: 3, data: new Float32Array(this.shape.position) },
      normal: { size: 3, data: new Float32Array(this.shape.normal) },
      index: { data: new Uint16Array(this.shape.index) },
      model: { instanced: 1, size: 16, data: new Float32Array(16 * this.room), usage: this.gl.DYNAMIC_DRAW },
      tint: { instanced: 1, size: 4, data: new Float32Array(4 * this.room), usage: this.gl.DYNAMIC_DRAW },
    });
    this.mesh = new Mesh(this.gl, { geometry, program: this.program, frustumCulled: false });
    return this.mesh;
  }
}

/** Points, lines or triangles that change with every frame. */
class Batch {
  private mesh: Mesh | null = null;
  private room = 0;
  private readonly program: Program;

  constructor(
    private readonly gl: OGLRenderingContext,
    shader: { vertex: string; fragment: string },
    private readonly mode: number,
    private readonly adds: boolean,
  ) {
    const uniforms = { view: { value: [] as number[] }, focal: { value: 1 }, sharpness: { value: 1 } };
    this.program = new Program(gl, { ...shader, uniforms, transparent: true, depthWrite: false, cullFace: false });
    if (adds) this.program.setBlendFunc(gl.ONE, gl.ONE);
  }

  draw(view: number[], { position, tint, radius }: Data, focal: number, sharpness: number): void {
    const count = position.length / 3;
    if (count === 0) return;
    const mesh = this.sized(count);
    const { attributes } = mesh.geometry;
    (attributes.position.data as Float32Array).set(position);
    (attributes.tint.data as Float32Array).set(tint);
    attributes.position.needsUpdate = attributes.tint.needsUpdate = true;
    if (attributes.radius !== undefined) {
      (attributes.radius.data as Float32Array).set(radius);
      attributes.radius.needsUpdate = true;
    }
    mesh.geometry.setDrawRange(0, count);
    Object.assign(this.program.uniforms.view, { value: view });
    this.program.uniforms.focal.value = focal;
    this.program.uniforms.sharpness.value = sharpness;
    mesh.draw();
  }

  private sized(count: number): Mesh {
    if (this.mesh !== null && count <= this.room) return this.mesh;
    this.room = Math.max(64, 2 * count);
    const buffer = (size: number) => ({ size, data: new Float32Array(size * this.room), usage: this.gl.DYNAMIC_DRAW });
    const geometry = new Geometry(this.gl, {
      position: buffer(3),
      tint: buffer(4),
      ...(this.adds && this.mode === this.gl.POINTS && { radius: buffer(1) }),
    });
    this.mesh = new Mesh(this.gl, { geometry, program: this.program, mode: this.mode, frustumCulled: false });
    return this.mesh;
  }
}

function glowData(glows: readonly Glow[]): Data {
  const data: Data = { position: [], tint: [], radius: [] };
  for (const { at, colour, radius } of glows) {
    data.position.push(...at);
    data.tint.push(...brightened(colour), 1);
    data.radius.push(radius);
  }
  return data;
}

const SIDES = 20;
/** Brightness of a beam at its source; it fades to nothing at its end. */
const BEAM_LIGHT = 0.16;

function beamData(beams: readonly Beam[]): Data {
  const data: Data = { position: [], tint: [], radius: [] };
  for (const { from, to, radius, colour } of beams) {
    const { u, v } = across(from, to);
    const rim = Array.from({ length: SIDES + 1 }, (_, i): Point => {
      const [c, s] = [Math.cos((2 * Math.PI * i) / SIDES) * radius, Math.sin((2 * Math.PI * i) / SIDES) * radius];
      return [to[0] + c * u[0] + s * v[0], to[1] + c * u[1] + s * v[1], to[2] + c * u[2] + s * v[2]];
    });
    const light = brightened(colour);
    for (let i = 0; i < SIDES; i++) {
      data.position.push(...from, ...rim[i], ...rim[i + 1]);
      data.tint.push(...light, BEAM_LIGHT, ...light, 0, ...light, 0);
    }
  }
  return data;
}

function parsed(colour: string): [number, number, number] {
  const hex = /^#([0-9a-f]{6})$/i.exec(colour)?.[1] ?? "0a0d13";
  return [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255) as [number, number, number];
}

const scaledAt = ([x, y, z]: Point, by: number) => [by, 0, 0, 0, 0, by, 0, 0, 0, 0, by, 0, x, y, z, 1];

function boxAt(rows: readonly [Point, Point, Point], [x, y, z]: Point, [a, b, c]: Point): number[] {
  const column = (i: 0 | 1 | 2, by: number) => [rows[0][i] * by, rows[1][i] * by, rows[2][i] * by, 0];
  return [...column(0, a), ...column(1, b), ...column(2, c), x, y, z, 1];
}

function across(from: Point, to: Point): { u: Point; v: Point; way: Point } {
  const way: Point = [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
  const length = Math.hypot(...way) || 1;
  const [x, y, z] = [way[0] / length, way[1] / length, way[2] / length];
  const other: Point = Math.abs(z) < 0.9 ? [0, 0, 1] : [1, 0, 0];
  const u: Point = [y * other[2] - z * other[1], z * other[0] - x * other[2], x * other[1] - y * other[0]];
  const size = Math.hypot(...u);
  const unit: Point = [u[0] / size, u[1] / size, u[2] / size];
  const v: Point = [y * unit[2] - z * unit[1], z * unit[0] - x * unit[2], x * unit[1] - y * unit[0]];
  return { u: unit, v, way };
}

function tubeAt(from: Point, to: Point, radius: number): number[] {
  const { u, v, way } = across(from, to);
  const thick = ([x, y, z]: Point) => [x * radius, y * radius, z * radius, 0];
  return [...thick(u), ...thick(v), ...way, 0, ...from, 1];
}

function ballShape(rings: number, sides: number): Vertices {
  const shape: Vertices = { position: [], normal: [], index: [] };
  for (let i = 0; i <= rings; i++)
    for (let j = 0; j <= sides; j++) {
      const [latitude, longitude] = [(Math.PI * i) / rings, (2 * Math.PI * j) / sides];
      const point = [Math.sin(latitude) * Math.cos(longitude), Math.sin(latitude) * Math.sin(longitude), Math.cos(latitude)];
      shape.position.push(...point);
      shape.normal.push(...point);
      const at = i * (sides + 1) + j;
      if (i < rings && j < sides) shape.index.push(at, at + sides + 1, at + 1, at + 1, at + sides + 1, at + sides + 2);
    }
  return shape;
}

function boxShape(): Vertices {
  const shape: Vertices = { position: [], normal: [], index: [] };
  for (const axis of [0, 1, 2])
    for (const side of [-0.5, 0.5]) {
      const first = shape.position.length / 3;
      for (const [a, b] of [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) {
        const [point, normal] = [[0, 0, 0], [0, 0, 0]];
        [point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3]] = [side, a, b];
        normal[axis] = Math.sign(side);
        shape.position.push(...point);
        shape.normal.push(...normal);
      }
      shape.index.push(first, first + 1, first + 2, first, first + 2, first + 3);
    }
  return shape;
}

/** Around z, from 0 to 1, of radius 1. */
function tubeShape(): Vertices {
  const shape: Vertices = { position: [], normal: [], index: [] };
  for (let i = 0; i <= SIDES; i++) {
    const [x, y] = [Math.cos((2 * Math.PI * i) / SIDES), Math.sin((2 * Math.PI * i) / SIDES)];
    shape.position.push(x, y, 0, x, y, 1);
    shape.normal.push(x, y, 0, x, y, 0);
    if (i < SIDES) shape.index.push(2 * i, 2 * i + 2, 2 * i + 1, 2 * i + 1, 2 * i + 2, 2 * i + 3);
  }
  return shape;
}
