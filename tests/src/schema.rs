//! Whether a JSON object is as its schema in `docs/schema` says: the part of JSON Schema that these files use.

use std::fs;
use std::path::PathBuf;

use serde_json::Value;

use crate::repository;

/// Words of JSON Schema that the files use; another one would be passed over silently.
const KNOWN: [&str; 9] =
    ["$schema", "$id", "title", "type", "properties", "required", "items", "additionalProperties", "const"];

/// The folder of the schemas.
pub fn folder() -> PathBuf {
    repository().join("docs/schema")
}

/// What is wrong with an object, a line each: it has the name of its schema.
pub fn faults(object: &Value) -> Vec<String> {
    let Some(name) = object["schema"].as_str() else { return vec!["it names no schema".to_owned()] };
    let file = folder().join(format!("{name}.json"));
    let Ok(text) = fs::read_to_string(&file) else { return vec![format!("{} cannot be read", file.display())] };
    let mut faults = Vec::new();
    match serde_json::from_str(&text) {
        Ok(schema) => check(&schema, object, name, &mut faults),
        Err(error) => faults.push(format!("{}: {error}", file.display())),
    }
    faults
}

fn check(schema: &Value, value: &Value, at: &str, faults: &mut Vec<String>) {
    let Some(words) = schema.as_object() else {
        faults.push(format!("{at}: a schema is an object"));
        return;
    };
    faults.extend(words.keys().filter(|word| !KNOWN.contains(&word.as_str())).map(|word| format!("{at}: `{word}`")));
    if let Some(expected) = words.get("const")
        && expected != value
    {
        faults.push(format!("{at}: {value} instead of {expected}"));
    }
    if !is_of_type(words.get("type"), value) {
        faults.push(format!("{at}: {} is not {}", shortened(value), words["type"]));
    }
    if let (Some(items), Some(values)) = (words.get("items"), value.as_array()) {
        values.iter().for_each(|one| check(items, one, &format!("{at}[]"), faults));
    }
    let Some(object) = value.as_object() else { return };
    let required = words.get("required").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str);
    faults.extend(required.filter(|key| !object.contains_key(*key)).map(|key| format!("{at}: no `{key}`")));
    for (key, one) in object {
        let at = format!("{at}.{key}");
        match (words.get("properties").and_then(|known| known.get(key)), words.get("additionalProperties")) {
            (Some(schema), _) => check(schema, one, &at, faults),
            (None, Some(Value::Bool(false))) => faults.push(format!("{at}: a key that the schema does not have")),
            (None, Some(schema @ Value::Object(_))) => check(schema, one, &at, faults),
            (None, _) => {}
        }
    }
}

fn is_of_type(expected: Option<&Value>, value: &Value) -> bool {
    let is_one = |name: &Value| match name.as_str() {
        Some("null") => value.is_null(),
        Some("boolean") => value.is_boolean(),
        Some("integer") => value.is_i64() || value.is_u64(),
        Some("number") => value.is_number(),
        Some("string") => value.is_string(),
        Some("array") => value.is_array(),
        Some("object") => value.is_object(),
        _ => false,
    };
    match expected {
        None => true,
        Some(Value::Array(names)) => names.iter().any(is_one),
        Some(name) => is_one(name),
    }
}

fn shortened(value: &Value) -> String {
    value.to_string().chars().take(60).collect()
}

/// An object that a command has printed.
///
/// # Panics
/// Where it is not as its schema says.
pub fn sound(object: Value) -> Value {
    let faults = faults(&object);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    object
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn what_differs_from_a_schema_is_named_with_its_place() {
        let schema = json!({
            "type": "object",
            "properties": {
                "schema": {"const": "a-1"},
                "modes": {"type": "array", "items": {"type": "object", "properties": {"hz": {"type": ["null", "number"]}}, "required": ["hz"], "additionalProperties": false}},
                "odds": {"type": "object", "additionalProperties": {"type": "integer"}},
            },
            "required": ["schema", "modes"],
            "additionalProperties": false,
        });
        let faults = |value: Value| {
            let mut faults = Vec::new();
            check(&schema, &value, "a-1", &mut faults);
            faults
        };
        assert_eq!(faults(json!({"schema": "a-1", "modes": [{"hz": null}, {"hz": 0.5}], "odds": {"x": 1}})), [""; 0]);
        assert_eq!(faults(json!({"schema": "a-2", "modes": []})), ["a-1.schema: \"a-2\" instead of \"a-1\""]);
        assert_eq!(faults(json!({"schema": "a-1"})), ["a-1: no `modes`"]);
        let several = faults(json!({"schema": "a-1", "modes": [{"hz": "fast"}, {}], "odds": {"x": 0.5}, "new": 1}));
        assert_eq!(
            several,
            [
                "a-1.modes[].hz: \"fast\" is not [\"null\",\"number\"]",
                "a-1.modes[]: no `hz`",
                "a-1.new: a key that the schema does not have",
                "a-1.odds.x: 0.5 is not \"integer\"",
            ]
        );
        let mut unknown = Vec::new();
        check(&json!({"pattern": "x"}), &json!("y"), "a", &mut unknown);
        assert_eq!(unknown, ["a: `pattern`"]);
    }
}
