//! Keys as their owner handles them: made once, kept apart, never shown.

use std::fs;
use std::path::Path;

use belfry_shared::seal::Key;
use belfry_tests::belfry_command;
use serde_json::Value;

/// What `belfry key` says on both outputs, and whether it was done.
fn key(keys: &Path, folder: &Path, arguments: &[&str]) -> (bool, String) {
    let mut command = belfry_command();
    let output = command.current_dir(folder).env("BELFRY_KEYS", keys).arg("key").args(arguments).output().unwrap();
    let said = [output.stdout, output.stderr].concat();
    (output.status.success(), String::from_utf8(said).unwrap())
}

#[test]
fn a_key_is_made_once_kept_from_others_and_never_shown() {
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("settings/keys");
    let (done, said) = key(&keys, folder.path(), &["new", "3"]);
    assert!(done && said.contains("probe-rs download") && said.contains("0x08060000"), "{said}");
    let text = fs::read_to_string(&keys).unwrap();
    let digits = text.lines().last().unwrap().strip_prefix("3 ").unwrap();
    assert!(digits.len() == 64 && !said.contains(&digits[..8]), "{said}");
    let image: [u8; 48] = fs::read(folder.path().join("node-3.key")).unwrap().try_into().unwrap();
    let of_image = Key::from_image(&image, 3).unwrap().unwrap();
    let hex: String = of_image.bytes().iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(hex, digits);
    #[cfg(unix)]
    for file in [&keys, &folder.path().join("node-3.key")] {
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(fs::metadata(file).unwrap().permissions().mode() & 0o777, 0o600, "{}", file.display());
    }

    // A second one would lock its owner out of the node.
    let (done, said) = key(&keys, folder.path(), &["new", "3", "--output", "second.key"]);
    assert!(!done && said.contains("node 3 has a key already"), "{said}");
    assert_eq!(fs::read_to_string(&keys).unwrap(), text);
    // Nor is an image overwritten, which may be the only one that a node got.
    let (done, said) = key(&keys, folder.path(), &["image", "3"]);
    assert!(!done && said.contains("node-3.key is there already"), "{said}");
    assert!(key(&keys, folder.path(), &["image", "3", "--output", "again.key"]).0);
    assert_eq!(fs::read(folder.path().join("again.key")).unwrap(), image);
    let (done, said) = key(&keys, folder.path(), &["image", "4"]);
    assert!(!done && said.contains("belfry key new 4"), "{said}");

    assert!(key(&keys, folder.path(), &["new", "4"]).0);
    let (done, said) = key(&keys, folder.path(), &["list", "--json"]);
    let list: Value = serde_json::from_str(&said).unwrap();
    assert!(done && list["nodes"] == serde_json::json!([3, 4]), "{said}");
}

#[test]
fn keys_are_refused_in_a_study_and_where_others_may_read_them() {
    let folder = tempfile::tempdir().unwrap();
    let study = folder.path().join("tower");
    let init = belfry_command().arg("init").arg(&study).args(["--template", "canton"]).output().unwrap();
    assert!(init.status.success());
    let (done, said) = key(&study.join("keys"), folder.path(), &["new", "1"]);
    assert!(!done && said.contains("lies in the study"), "{said}");
    assert!(!study.join("keys").exists() && !folder.path().join("node-1.key").exists());
    // An image is the key.
    let (done, said) = key(&folder.path().join("keys"), &study, &["new", "1"]);
    assert!(!done && said.contains("would lie in the study"), "{said}");
    assert!(!study.join("node-1.key").exists() && !folder.path().join("keys").exists());
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let keys = folder.path().join("keys");
        assert!(key(&keys, folder.path(), &["new", "1"]).0);
        fs::set_permissions(&keys, fs::Permissions::from_mode(0o644)).unwrap();
        let (done, said) = key(&keys, folder.path(), &["list"]);
        assert!(!done && said.contains("chmod 600"), "{said}");
    }
}
