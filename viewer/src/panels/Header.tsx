// Name of the mission, and the controls of a video player.
import { useState } from "preact/hooks";
import { useCell } from "../state/cell";
import { seekAndShow } from "../state/moves";
import { setSpeed, shuttle, step, toggle } from "../state/playback";
import { copyLink } from "../state/address";
import { MODES, useSession, type Mode } from "../state/session";
import { Name } from "../text/Name";
import { clock, timeOfDay } from "../text/time";
import { Icon } from "./Icon";
import { ThemeTool } from "./ThemeTool";
import { Tool } from "./Tool";
import { VerdictLine } from "./VerdictLine";

const KINDS = { dry_run: "dry run", recording: "recording", journal: "journal" };

export function Header() {
  const session = useSession();
  const { scenario, kind, cut_off } = session.show.mission;
  return (
    <header>
      <h1>
        <Name text={scenario} />
      </h1>
      <span class="badge">{KINDS[kind]}</span>
      <Modes />
      <span class="gap" />
      <Transport />
      <span class="gap" />
      <CopyLink />
      <ThemeTool theme={session.theme} />
      <Tool label="Keys and help (?)" press={() => (session.help.value = true)}>
        ?
      </Tool>
      <VerdictLine />
      {typeof cut_off === "string" && cut_off !== "" && (
        <p class="cut-off">
          ⚠ incomplete: <Name text={cut_off} />
        </p>
      )}
    </header>
  );
}

const MODE_NAMES: Record<Mode, { name: string; key: string }> = {
  show: { name: "Show", key: "S" },
  check: { name: "Check", key: "G" },
  engineer: { name: "Engineer", key: "E" },
};

function Modes() {
  const session = useSession();
  const mode = useCell(session.mode);
  return (
    <div class="modes" role="group" aria-label="What the page is for">
      {MODES.map((key) => (
        <Tool
          key={key}
          label={`${MODE_NAMES[key].name} (${MODE_NAMES[key].key})`}
          pressed={key === mode}
          press={() => (session.mode.value = key)}
        >
          {MODE_NAMES[key].name}
        </Tool>
      ))}
    </div>
  );
}

function CopyLink() {
  const session = useSession();
  const [said, setSaid] = useState("");
  const copy = async () => setSaid((await copyLink(session)) ? "copied" : "in the address bar");
  return (
    <>
      <Tool label="Copy a link to this instant" press={() => void copy()}>
        Link
      </Tool>
      <small role="status" id="link-copied">
        {said}
      </small>
    </>
  );
}

function Transport() {
  const session = useSession();
  const playing = useCell(session.playing);
  const { from, to, epoch } = session.show.mission;
  return (
    <div class="transport" role="group" aria-label="Playback">
      <Tool label="To the start (Home)" press={() => seekAndShow(session, from)}>
        <Icon name="first" />
      </Tool>
      <Tool label="To the step before, of the focused lane (,)" press={() => step(session, -1)}>
        <Icon name="stepBefore" />
      </Tool>
      <Tool label="Play backwards (J)" press={() => shuttle(session, -1)}>
        <Icon name="back" />
      </Tool>
      <Tool label={playing ? "Pause (Space)" : "Play (Space)"} press={() => toggle(session)}>
        <Icon name={playing ? "pause" : "play"} />
      </Tool>
      <Tool label="Play, again for twice the speed (L)" press={() => shuttle(session, 1)}>
        <Icon name="forward" />
      </Tool>
      <Tool label="To the step after, of the focused lane (.)" press={() => step(session, 1)}>
        <Icon name="stepAfter" />
      </Tool>
      <Tool label="To the end (End)" press={() => seekAndShow(session, to)}>
        <Icon name="last" />
      </Tool>
      <Times epoch={epoch} />
      <Speed />
    </div>
  );
}

function Times({ epoch }: { epoch: string }) {
  const session = useSession();
  const playhead = useCell(session.playhead);
  return (
    <span class="times">
      <output id="playhead" aria-label="Playhead" aria-live="off">
        {clock(playhead)}
      </output>
      {session.show.mission.kind !== "dry_run" && <small title="Time of day on this computer">{timeOfDay(epoch, playhead)}</small>}
    </span>
  );
}

function Speed() {
  const session = useSession();
  const speed = useCell(session.speed);
  const text = `${speed < 0 ? "-" : ""}${Number(Math.abs(speed).toFixed(2))}×`;
  return (
    <label class="speed">
      <span class="hidden">Speed</span>
      <input
        type="range"
        min={-1}
        max={1}
        step={0.05}
        value={Math.log10(Math.abs(speed))}
        aria-valuetext={text}
        onInput={(event) => setSpeed(session, Number((10 ** Number(event.currentTarget.value)).toFixed(2)))}
      />
      <output id="speed">{text}</output>
    </label>
  );
}
