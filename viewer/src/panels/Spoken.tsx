// Announces to screen readers where the playhead stopped and what the focused lane does there.
import { useEffect } from "preact/hooks";
import { useCell } from "../state/cell";
import { useSession, type Session } from "../state/session";
import { describeReading } from "../text/reading";
import { clock } from "../text/time";
import { visible } from "../text/visible";

/** Waits until the playhead rests, so that not every frame is announced. */
const REST_MS = 300;

export function Spoken() {
  const session = useSession();
  const spoken = useCell(session.spoken);
  useEffect(() => {
    let timer = 0;
    const later = () => {
      window.clearTimeout(timer);
      if (!session.playing.value) timer = window.setTimeout(() => (session.spoken.value = describe(session)), REST_MS);
    };
    const stops = [session.playhead, session.playing, session.focusedRow].map((cell) => cell.subscribe(later));
    return () => stops.forEach((stop) => stop());
  }, [session]);
  return (
    <p class="hidden" role="status" id="spoken">
      {spoken}
    </p>
  );
}

function describe(session: Session): string {
  const at = session.playhead.value;
  const track = session.focusedTrack;
  if (track === null) return clock(at);
  const cue = session.show.cueAt(track.robotIndex, at);
  const where = cue === null ? "" : `, cue ${cue.cue.name}`;
  return visible(`${clock(at)}, ${track.robot.id} ${track.name}: ${describeReading(track, track.at(at))}${where}`);
}
