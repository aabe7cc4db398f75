"""Keeps docs/schema, the JSON schemas of what commands print with --json.

    python3 tests/schema.py FILE...         widens the schema that each object names until it holds the object; one that is new is made
    python3 tests/schema.py --check FILE...   says by the package jsonschema whether the files are as their schemas say

A schema has what programs can rely on: types of values, and keys that are always there. Where keys are names (a table by effect or by node),
write "additionalProperties" with one schema for all values by hand: it stays.
"""

import json
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs/schema"
NAMES = {dict: "object", list: "array", str: "string", bool: "boolean", int: "integer", float: "number", type(None): "null"}


def types(schema):
    kind = schema.get("type", [])
    return [kind] if isinstance(kind, str) else list(kind)


def widened(schema, value, is_new=False):
    """The schema, which holds the value besides."""
    schema = dict(schema)
    known = types(schema)
    name = NAMES[type(value)]
    if name == "integer" and "number" in known:
        name = "number"
    if name == "number":
        known = [one for one in known if one != "integer"]
    if name not in known:
        known = sorted([*known, name])
    schema["type"] = known[0] if len(known) == 1 else known
    if isinstance(value, dict):
        if isinstance(schema.get("additionalProperties"), dict):
            for one in value.values():
                schema["additionalProperties"] = widened(schema["additionalProperties"], one)
            return schema
        before = schema.get("properties")
        properties = dict(before or {})
        for key, one in value.items():
            properties[key] = widened(properties.get(key, {}), one)
        required = list(value) if before is None else [key for key in schema.get("required", []) if key in value]
        schema |= {"properties": properties, "required": required, "additionalProperties": False}
    if isinstance(value, list) and (value or "items" not in schema):
        items = schema.get("items", {})
        for one in value:
            items = widened(items, one)
        schema["items"] = items
    return schema


def path_of(name):
    return FOLDER / f"{name}.json"


def objects(file):
    """The objects in a file: one, or one a line."""
    text = pathlib.Path(file).read_text()
    try:
        return [json.loads(text)]
    except json.JSONDecodeError:
        return [json.loads(line) for line in text.splitlines() if line.strip()]


def text(value, indent=0):
    """JSON, of which what fits stands on one line."""
    line = json.dumps(value, ensure_ascii=False)
    if len(line) + indent <= 150 or not isinstance(value, (dict, list)):
        return line
    inside = " " * (indent + 1)
    if isinstance(value, list):
        return "[\n" + ",\n".join(inside + text(one, indent + 1) for one in value) + "\n" + " " * indent + "]"
    entries = (f"{inside}{json.dumps(key, ensure_ascii=False)}: {text(one, indent + 1)}" for key, one in value.items())
    return "{\n" + ",\n".join(entries) + "\n" + " " * indent + "}"


def widen(files):
    schemas = {}
    for file in files:
        for value in objects(file):
            name = value["schema"]
            path = path_of(name)
            if name not in schemas:
                start = {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": path.name, "title": f"belfry {name}"}
                schemas[name] = json.loads(path.read_text()) if path.exists() else start
            schemas[name] = widened(schemas[name], value)
            schemas[name]["properties"]["schema"] = {"const": name}
    FOLDER.mkdir(exist_ok=True)
    for name, schema in schemas.items():
        path_of(name).write_text(text(schema) + "\n")
        print(path_of(name))


def check(files):
    sys.path.insert(0, str(ROOT / "tests"))
    import environment

    environment.enter(ROOT / "target/schema", ["jsonschema==4.25.1"])
    import jsonschema

    wrong = 0
    for file in files:
        for value in objects(file):
            schema = json.loads(path_of(value["schema"]).read_text())
            jsonschema.Draft202012Validator.check_schema(schema)
            for error in jsonschema.Draft202012Validator(schema).iter_errors(value):
                print(f"{file}: {error.json_path}: {error.message[:200]}")
                wrong += 1
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--check"]:
        check(sys.argv[2:])
    elif len(sys.argv) > 1:
        widen(sys.argv[1:])
    else:
        sys.exit(__doc__)
