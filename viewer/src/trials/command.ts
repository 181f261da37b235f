// The command that replays a trial, for a POSIX shell.

export function replayOf(words: readonly string[], trial: number): string {
  return [...words, "--trial", String(trial)].map(quoted).join(" ");
}

function quoted(word: string): string {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
}
