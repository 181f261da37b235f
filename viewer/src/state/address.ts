// The state of the page in its address, such as `#t=63.9&cue=to+the+heart&view=front`, so that a link leads to an instant.
import { isPreset } from "../stage/camera";
import { seekAndShow } from "./moves";
import { MODES, type Mode, type Session } from "./session";

/** Applies the address. Returns whether it names an instant. */
export function applyAddress(session: Session, hash: string): boolean {
  const parts = new URLSearchParams(hash.replace(/^#/, ""));
  const mode = parts.get("mode");
  if (mode !== null && MODES.includes(mode as Mode)) session.mode.value = mode as Mode;
  const view = parts.get("view");
  if (view !== null && isPreset(view)) session.preset.value = view;
  const cue = session.show.cues.find((placed) => placed.cue.name === parts.get("cue"));
  if (cue !== undefined) session.cue.value = cue.index;
  const seconds = parts.has("t") ? Number(parts.get("t")) : NaN;
  if (Number.isFinite(seconds)) seekAndShow(session, 1000 * seconds);
  else if (cue !== undefined) seekAndShow(session, cue.start);
  return Number.isFinite(seconds) || cue !== undefined;
}

export function addressOf(session: Session): string {
  const parts = new URLSearchParams({ t: (session.playhead.value / 1000).toFixed(3) });
  const cue = session.cue.value;
  if (cue !== null) parts.set("cue", session.show.cues[cue].cue.name);
  parts.set("view", session.preset.value);
  parts.set("mode", session.mode.value);
  return `#${parts.toString()}`;
}

export function listenToAddress(session: Session): () => void {
  const changed = () => applyAddress(session, location.hash);
  window.addEventListener("hashchange", changed);
  return () => window.removeEventListener("hashchange", changed);
}

/** Puts the link into the address and, if the browser permits it, into the clipboard. Returns whether it is in the clipboard. */
export async function copyLink(session: Session): Promise<boolean> {
  const address = addressOf(session);
  history.replaceState(null, "", address);
  try {
    await navigator.clipboard.writeText(location.href);
    return true;
  } catch {
    return false;
  }
}
