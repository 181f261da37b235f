export function Curves() { return <section class="panel curves" aria-label="Curves"></section>; }
