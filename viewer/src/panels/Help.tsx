// All keys, from the same table that runs them.
import { useEffect, useRef } from "preact/hooks";
import { useCell } from "../state/cell";
import { KEYS } from "../state/keys";
import { useSession } from "../state/session";

export function Help() {
  const session = useSession();
  const open = useCell(session.help);
  const dialog = useRef<HTMLDialogElement>(null);
  useEffect(() => {
    if (open && dialog.current?.open === false) dialog.current.showModal();
    if (!open) dialog.current?.close();
  }, [open]);
  return (
    <dialog ref={dialog} class="help" aria-labelledby="help-title" onClose={() => (session.help.value = false)}>
      <h2 id="help-title">Keys</h2>
      <div class="help-keys" tabIndex={0} role="region" aria-label="List of keys">
        <table>
          <tbody>
            {KEYS.map(({ keys, does }) => (
              <tr key={does}>
                <th scope="row">
                  {keys.map((key) => (
                    <kbd key={key}>{named(key)}</kbd>
                  ))}
                </th>
                <td>{does}</td>
              </tr>
            ))}
          </tbody>
        </table>
        <p>
          With the mouse: the wheel zooms at the pointer, Shift and the wheel pan, dragging pans, Shift and dragging select a
          range. A click on a cue shows its lines; a double click zooms to it. A drag on the axis of time moves the playhead. In
          the stage, dragging or arrows turn the view (with Shift: move it), plus and minus zoom, F fits.
        </p>
      </div>
      <button type="button" class="tool" onClick={() => (session.help.value = false)}>
        Close
      </button>
    </dialog>
  );
}

const named = (key: string) => key.replace(/[^+]+/g, (part) => NAMES[part] ?? part);
const NAMES: Record<string, string> = {
  " ": "Space",
  ArrowLeft: "←",
  ArrowRight: "→",
  ArrowUp: "↑",
  ArrowDown: "↓",
  Escape: "Esc",
};
