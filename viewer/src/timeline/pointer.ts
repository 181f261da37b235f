// Mouse and touch on the timeline: scrub, pan, select a range, zoom, and click items.
import { pan, seek, show, zoom } from "../state/moves";
import type { Session } from "../state/session";
import { HEAD_HEIGHT } from "./head";
import { scaleOf } from "./scale";

/** A movement of fewer pixels is a click, not a drag. */
const STILL = 4;

interface Gesture {
  x: number;
  y: number;
  scrolled: number;
  kind: "scrub" | "pan" | "select";
  moved: boolean;
  from: number;
  to: number;
}

export interface PointerTarget {
  canvas: HTMLCanvasElement;
  session: Session;
  scroller: () => HTMLElement | null;
  click: (x: number, y: number) => void;
  hover: (x: number, y: number) => void;
  leave: () => void;
}

export function listen(target: PointerTarget): () => void {
  const { canvas, session } = target;
  const fingers = new Map<number, PointerEvent>();
  let gesture: Gesture | null = null;
  const scale = () => scaleOf(session.view.value, canvas.clientWidth);

  const down = (event: PointerEvent) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
    const select = event.shiftKey || session.drag.value === "select";
    const kind = event.offsetY < HEAD_HEIGHT / 4 && !select ? "scrub" : select ? "select" : "pan";
    const { from, to } = session.view.value;
    gesture = { x: event.offsetX, y: event.offsetY, scrolled: target.scroller()?.scrollTop ?? 0, kind, moved: false, from, to };
    if (kind === "scrub") seek(session, scale().ms(event.offsetX));
  };

  const move = (event: PointerEvent) => {
    if (gesture === null || !fingers.has(event.pointerId)) {
      target.hover(event.offsetX, event.offsetY);
      return;
    }
    if (fingers.size === 2) {
      pinch(session, canvas.clientWidth, fingers, event);
      gesture.moved = true;
      return;
    }
    fingers.set(event.pointerId, event);
    drag(gesture, event);
  };

  const drag = (held: Gesture, event: PointerEvent) => {
    if (!held.moved && Math.hypot(event.offsetX - held.x, event.offsetY - held.y) < STILL) return;
    held.moved = true;
    if (held.kind === "scrub") seek(session, scale().ms(event.offsetX));
    if (held.kind === "pan") {
      const ms = (event.offsetX - held.x) * scale().perPixel;
      show(session, { from: held.from - ms, to: held.to - ms });
      const scroller = target.scroller();
      if (scroller !== null && event.pointerType === "mouse") scroller.scrollTop = held.scrolled - (event.offsetY - held.y);
    }
    if (held.kind === "select") {
      const times = [scale().ms(held.x), scale().ms(event.offsetX)].sort((a, b) => a - b);
      session.range.value = { from: times[0], to: times[1] };
    }
  };

  const up = (event: PointerEvent) => {
    fingers.delete(event.pointerId);
    if (gesture !== null && !gesture.moved && gesture.kind !== "scrub") target.click(event.offsetX, event.offsetY);
    if (fingers.size === 0) gesture = null;
  };

  const cancel = (event: PointerEvent) => {
    fingers.delete(event.pointerId);
    gesture = null;
  };

  const wheel = (event: WheelEvent) => {
    event.preventDefault();
    const sideways = event.shiftKey ? event.deltaY || event.deltaX : event.deltaX;
    if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) pan(session, sideways * scale().perPixel);
    else zoom(session, Math.exp(-Math.max(-200, Math.min(200, event.deltaY)) / 300), scale().ms(event.offsetX));
  };

  const listeners = { pointerdown: down, pointermove: move, pointerup: up, pointercancel: cancel, pointerleave: target.leave };
  for (const [name, listener] of Object.entries(listeners)) canvas.addEventListener(name, listener as EventListener);
  canvas.addEventListener("wheel", wheel, { passive: false });
  return () => {
    for (const [name, listener] of Object.entries(listeners)) canvas.removeEventListener(name, listener as EventListener);
    canvas.removeEventListener("wheel", wheel);
  };
}

/** Two fingers: the content between them stays between them. */
function pinch(session: Session, width: number, fingers: Map<number, PointerEvent>, event: PointerEvent): void {
  const [first, second] = [...fingers.values()];
  const still = first.pointerId === event.pointerId ? second : first;
  const before = first.pointerId === event.pointerId ? first : second;
  const distance = Math.abs(before.offsetX - still.offsetX);
  const next = Math.abs(event.offsetX - still.offsetX);
  fingers.set(event.pointerId, event);
  if (distance < 10 || next < 10) return;
  zoom(session, next / distance, scaleOf(session.view.value, width).ms(still.offsetX));
}
