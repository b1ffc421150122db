//! What lines of OBJ and MTL files name, and where that is found: for the importer, and for the look at what a
//! scene refers to.

use std::path::{Path, PathBuf};

use crate::import::error::ImportError;
use crate::import::text::before_comment;
use crate::import::uri::Folder;

/// A statement: its keyword in small letters, and the line behind it.
pub(super) fn statement(line: &[u8]) -> Option<(Vec<u8>, &[u8])> {
    let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
    (end > 0).then(|| (line[..end].to_ascii_lowercase(), line[end..].trim_ascii()))
}

/// Whether a line that ends in a backslash goes on in the next: a comment does not, nor does one that gives a name,
/// which may end so.
pub(super) fn may_join(line: &[u8]) -> bool {
    let names = [&b"o"[..], b"g", b"usemtl", b"newmtl"];
    let is_name = |word: &[u8]| names.contains(&word) || word.starts_with(b"map_");
    statement(line).is_some_and(|(word, _)| !is_name(&word)) && before_comment(line) == line
}

/// The name that stands behind a keyword.
pub(super) fn name(rest: &[u8]) -> String {
    String::from_utf8_lossy(before_comment(rest)).into_owned()
}

/// The file of a name in `by`, the scene or a library of it. Modellers write paths of their own machine, and put the
/// file beside the scene: so it is looked for beside `by`, then beside the scene, both whole and without folders.
pub(super) fn locate(
    scene: &Path,
    by: &Path,
    at: &str,
    name: &str,
) -> Result<PathBuf, ImportError> {
    let name = name.trim_matches('"').replace("\\ ", " ").replace('\\', "/");
    let last = name.rsplit('/').next().unwrap_or(&name);
    let mut places = vec![(by, &name[..]), (by, last)];
    if by != scene {
        places.extend([(scene, &name[..]), (scene, last)]);
    }
    let found = places.into_iter().map(|(by, name)| Folder { file: scene, by }.named(at, name));
    let mut error = None;
    for outcome in found {
        match outcome {
            Ok(path) => return Ok(path),
            Err(why) => error = error.or(Some(why)),
        }
    }
    Err(error.expect("there is a place"))
}

/// A library that a line names, and its file.
pub(super) type Named = (String, Result<PathBuf, ImportError>);

/// The libraries of a line. A name may hold blanks, with backslashes before them or without; a line may hold several.
pub(super) fn libraries(scene: &Path, at: &str, names: &str) -> Vec<Named> {
    let find = |name: &str| locate(scene, scene, at, name);
    if let Ok(path) = find(names) {
        return vec![(names.to_owned(), Ok(path))];
    }
    let ends = |word: &str| word.trim_end_matches('"').to_ascii_lowercase().ends_with(".mtl");
    let mut found = Vec::new();
    let words = split_unescaped(names);
    for group in words.split_inclusive(|word| ends(word)) {
        let joined = group.join(" ");
        let whole = find(&joined);
        let alone = || group.iter().filter_map(|word| Some((word.clone(), Ok(find(word).ok()?))));
        let mut alone: Vec<Named> = if whole.is_ok() { vec![] } else { alone().collect() };
        match alone.is_empty() {
            true => found.push((joined, whole)),
            false => found.append(&mut alone),
        }
    }
    found
}

/// Words of a line, blanks behind backslashes being part of them; each once.
fn split_unescaped(names: &str) -> Vec<String> {
    // No name holds this.
    const BLANK: &str = "\0";
    let joined = names.replace("\\ ", BLANK);
    let mut words: Vec<String> = Vec::new();
    let mut known = std::collections::BTreeSet::new();
    for word in joined.split_whitespace() {
        if known.insert(word) {
            words.push(word.replace(BLANK, " "));
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keywords_are_read_in_any_case_and_names_to_their_end() {
        assert_eq!(statement(b"Map_Kd  a b.png"), Some((b"map_kd".to_vec(), &b"a b.png"[..])));
        assert_eq!(statement(b""), None);
        assert_eq!(name(b"red wood # dark"), "red wood");
        assert_eq!(name(b"part #3"), "part #3");
    }

    #[test]
    fn comments_and_names_do_not_go_on_in_the_next_line() {
        for line in ["# a \\", "v 1 2 # a \\", "usemtl a\\", "O a\\", "map_Kd C:\\t\\"] {
            assert!(!may_join(line.as_bytes()), "{line}");
        }
        for line in ["f 1 2 \\", "v 1 2\\", "mtllib a.mtl \\"] {
            assert!(may_join(line.as_bytes()), "{line}");
        }
    }

    #[test]
    fn libraries_of_a_line_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.mtl", "my paint.MTL", "b c.mtl", "plain"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let scene = folder.path().join("s.obj");
        let found = |names: &str| -> Vec<(String, bool)> {
            let all = libraries(&scene, "line 1", names);
            all.into_iter().map(|(name, path)| (name, path.is_ok())).collect()
        };
        let expect = |names: &[(&str, bool)]| -> Vec<(String, bool)> {
            names.iter().map(|&(name, is)| (name.to_owned(), is)).collect()
        };
        assert_eq!(found("my paint.MTL"), expect(&[("my paint.MTL", true)]));
        assert_eq!(found("my\\ paint.MTL"), expect(&[("my\\ paint.MTL", true)]));
        assert_eq!(found("\"b c.mtl\""), expect(&[("\"b c.mtl\"", true)]));
        assert_eq!(
            found("a.mtl b c.mtl my\\ paint.MTL none here.mtl a.mtl"),
            expect(&[
                ("a.mtl", true),
                ("b c.mtl", true),
                ("my paint.MTL", true),
                ("none here.mtl", false),
            ])
        );
        assert_eq!(found("gone plain"), expect(&[("plain", true)]));
        // As many names as a line holds take no more than their number of looks.
        let many: Vec<String> = (0..20_000).map(|n| format!("n{n}")).collect();
        assert_eq!(found(&many.join(" ")).len(), 1);
    }

    #[test]
    fn what_a_library_names_is_found_beside_it_or_beside_the_scene() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        std::fs::create_dir_all(root.join("lib/deep")).unwrap();
        std::fs::create_dir_all(root.join("maps")).unwrap();
        for name in ["lib/t.png", "t.png", "maps/m.png", "s.png", "lib/deep/d.png"] {
            std::fs::write(root.join(name), name).unwrap();
        }
        std::fs::write(root.parent().unwrap().join("outside.png"), "").unwrap();
        let (scene, by) = (root.join("s.obj"), root.join("lib/s.mtl"));
        let found = |name: &str| {
            let path = locate(&scene, &by, "", name).ok()?;
            Some(std::fs::read_to_string(path).unwrap())
        };
        for (name, place) in [
            ("t.png", Some("lib/t.png")),
            ("../t.png", Some("t.png")),
            ("..\\maps\\m.png", Some("maps/m.png")),
            ("maps/m.png", Some("maps/m.png")),
            ("D:/pictures/s.png", Some("s.png")),
            ("deep/d.png", Some("lib/deep/d.png")),
            ("deep/../t.png", Some("lib/t.png")),
            ("../../outside.png", None),
            ("none.png", None),
        ] {
            assert_eq!(found(name).as_deref(), place, "{name}");
        }
    }
}
