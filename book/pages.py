"""Writes the pages of the book that the program itself describes: `pages.py PROGRAM FOLDER`."""

import json
import subprocess
import sys
from pathlib import Path


def output(*words):
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


def subcommands(text):
    lines = iter(text.splitlines())
    for line in lines:
        if line == "Commands:":
            break
    names = []
    for line in lines:
        if not line.strip():
            break
        if line.startswith("  ") and line[2] != " ":
            names.append(line.split()[0])
    return [name for name in names if name != "help"]


def commands(program, path=()):
    """The help of a command, and that of those below it."""
    text = output(program, *path, "--help")
    yield f"## {' '.join(('downbeat', *path))}\n\n```text\n{text.strip()}\n```\n"
    for name in subcommands(text):
        yield from commands(program, (*path, name))


def kind(schema):
    """What a value is, in a word or a link to it."""
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join(f"`{word}`" for word in schema["enum"])
    for key in ("anyOf", "oneOf"):
        if key in schema:
            kinds = [kind(one) for one in schema[key] if one.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    kinds = schema.get("type", "any")
    words = [kinds] if isinstance(kinds, str) else [one for one in kinds if one != "null"]
    if words == ["array"] and isinstance(schema.get("items"), dict):
        return f"list of {kind(schema['items'])}"
    if words == ["object"] and isinstance(schema.get("additionalProperties"), dict):
        return f"map to {kind(schema['additionalProperties'])}"
    return " or ".join(words)


def cell(text):
    return text.replace("|", "\\|").replace("\n", " ")


def meaning(value, parts):
    referred = parts.get(value.get("$ref", "").rsplit("/", 1)[-1], {})
    return cell(value.get("description") or referred.get("description", ""))


def keys(schema, parts):
    rows = ["| key | value | required | meaning |", "|---|---|---|---|"]
    for name, value in schema.get("properties", {}).items():
        required = "yes" if name in schema.get("required", []) else "no"
        rows.append(f"| `{name}` | {cell(kind(value))} | {required} | {meaning(value, parts)} |")
    return "\n".join(rows) + "\n" if len(rows) > 2 else f"Value: {kind(schema)}\n"


def schema_page(program, name):
    schema = json.loads(output(program, "schema", name))
    parts = schema.get("$defs", {})
    yield f"# Keys: {schema['title']}\n\n{schema.get('description', '')}\n\n"
    yield f"`downbeat schema {name}` prints this schema for editors and programs.\n\n{keys(schema, parts)}\n"
    for part, inner in parts.items():
        yield f"## {part}\n\n{inner.get('description', '')}\n\n{keys(inner, parts)}\n"


def main(program, folder):
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "commands.md").write_text("# Commands\n\n" + "\n".join(commands(program)))
    for name in ("scenario", "fleet", "report", "protocol"):
        (folder / f"schema-{name}.md").write_text("".join(schema_page(program, name)))


main(*sys.argv[1:])
