// What became of the mission, in one sentence. A click moves to the instant that it concerns.
import { verdict } from "../data/verdict";
import { seekAndShow } from "../state/moves";
import { useSession } from "../state/session";
import { visible } from "../text/visible";

const MARKS = { good: "✓", warn: "⚠", bad: "✕" };

export function VerdictLine() {
  const session = useSession();
  const { grade, text, at } = verdict(session.show);
  const content = (
    <>
      <span aria-hidden="true">{MARKS[grade]}</span> <bdi>{visible(text)}</bdi>
    </>
  );
  return (
    <p id="verdict" class={`verdict ${grade}`}>
      {at === null ? (
        content
      ) : (
        <button type="button" class="verdict-link" title="Move the playhead there" onClick={() => seekAndShow(session, at)}>
          {content}
        </button>
      )}
    </p>
  );
}
