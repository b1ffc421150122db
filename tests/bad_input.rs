//! Bad input ends in a message that names what is wrong, the right exit code, and nothing half written.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use std::path::{Path, PathBuf};
use std::process::Stdio;
use support::{Scene, fail, occluster, succeed, text};
use tempfile::TempDir;

/// A GLB around a JSON chunk and a binary chunk.
fn glb(json: &str, binary: &[u8]) -> Vec<u8> {
    let padded = |bytes: &[u8], fill: u8| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), fill);
        bytes
    };
    let (json, binary) = (padded(json.as_bytes(), b' '), padded(binary, 0));
    let total = 12 + 8 + json.len() + 8 + binary.len();
    let mut out = b"glTF".to_vec();
    for word in [2, total as u32, json.len() as u32] {
        out.extend(word.to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(json);
    out.extend((binary.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(binary);
    out
}

/// A triangle whose JSON can be made wrong, and its positions.
fn triangle(edit: impl Fn(String) -> String, positions: [f32; 9]) -> Vec<u8> {
    let json = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
        "meshes":[{"name":"wedge","primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,1]}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36}]}"#;
    let binary: Vec<u8> = positions.iter().flat_map(|p| p.to_le_bytes()).collect();
    glb(&edit(json.to_owned()), &binary)
}

const GOOD: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0];

fn write(folder: &TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Names in a folder.
fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_bad_source_is_refused_by_name_and_leaves_nothing() {
    let folder = TempDir::new().unwrap();
    let output = folder.path().join("out.occ");
    let bake = |input: &Path, code: i32, says: &str| {
        let before = names(folder.path());
        fail(&["bake", text(input), "-o", text(&output)], code, says);
        assert_eq!(names(folder.path()), before, "{says}");
    };
    let replaced =
        |from: &'static str, to: &'static str| triangle(move |json| json.replace(from, to), GOOD);

    let good = write(&folder, "good.glb", &triangle(|json| json, GOOD));
    succeed(&["bake", text(&good), "-o", text(&output)]);
    std::fs::remove_file(&output).unwrap();

    bake(&folder.path().join("absent.glb"), 66, "absent.glb");
    bake(&write(&folder, "empty.glb", b""), 65, "empty.glb");
    bake(&write(&folder, "foreign.glb", b"PK\x03\x04 this is an archive"), 65, "foreign.glb");
    let whole = triangle(|json| json, GOOD);
    bake(&write(&folder, "cut.glb", &whole[..whole.len() - 20]), 65, "cut.glb");
    bake(
        &write(&folder, "count.glb", &replaced("\"count\":3", "\"count\":3000000000")),
        65,
        "accessor",
    );
    let nan = GOOD.map(|p| if p == 0.0 { p } else { f32::NAN });
    bake(&write(&folder, "nan.glb", &triangle(|json| json, nan)), 65, "wedge");
    let missing = replaced("{\"byteLength\":36}]}", "{\"byteLength\":36,\"uri\":\"gone.bin\"}]}");
    bake(&write(&folder, "missing.glb", &missing), 66, "gone.bin");
    let leaving =
        replaced("{\"byteLength\":36}]}", "{\"byteLength\":36,\"uri\":\"../../etc/passwd\"}]}");
    bake(&write(&folder, "leaving.glb", &leaving), 65, "../../etc/passwd");
    let unknown = replaced(
        "{\"asset\"",
        "{\"extensionsRequired\":[\"ACME_wobble\"],\"extensionsUsed\":[\"ACME_wobble\"],\"asset\"",
    );
    bake(&write(&folder, "unknown.glb", &unknown), 65, "ACME_wobble");
    bake(
        &write(&folder, "nothing.glb", &replaced("\"nodes\":[0]", "\"nodes\":[]")),
        65,
        "nothing.glb",
    );
    fail(&["bake", text(&good), "-o", "/no/such/folder/x.occ"], 74, "/no/such/folder");
    assert!(!Path::new("/no").exists());
    fail(&["bake", text(&good), "-o", text(folder.path())], 74, text(folder.path()));
}

#[test]
fn a_bad_scene_file_is_refused_by_every_verb_that_reads_one() {
    let scene = Scene::synth("plant", 200_000);
    let bytes = std::fs::read(&scene.occ).unwrap();
    let path = scene.file("bad.occ");
    let refused = |bytes: &[u8], code: i32| {
        std::fs::write(&path, bytes).unwrap();
        for verb in ["inspect", "verify", "path", "replay"] {
            let output = scene.file("never.csv");
            let mut arguments = vec![verb, text(&path)];
            if verb == "path" {
                arguments.extend(["-o", text(&output)]);
            }
            fail(&arguments, code, "bad.occ");
            assert!(!output.exists());
        }
    };
    fail(&["inspect", text(&scene.file("absent.occ"))], 66, "absent.occ");
    refused(b"", 65);
    refused(
        b"not a scene file at all, but long enough to hold a header of one: 0123456789 0123456789",
        65,
    );
    refused(&bytes[..bytes.len() / 2], 65);
    let mut flipped = bytes.clone();
    flipped[9] ^= 0x40;
    refused(&flipped, 65);

    let mut late = bytes.clone();
    let middle = late.len() / 2;
    late[middle] ^= 1;
    std::fs::write(&path, &late).unwrap();
    fail(&["verify", text(&path)], 65, "bad.occ");
    std::fs::write(&path, &bytes).unwrap();
    succeed(&["verify", text(&path)]);
}

#[test]
fn a_bad_path_is_refused_by_its_line() {
    let scene = Scene::synth("pipes", 50_000);
    let header = "eye_x,eye_y,eye_z,target_x,target_y,target_z,up_x,up_y,up_z,fov_y_deg\n";
    let path = scene.file("bad.csv");
    let refused = |text_of_it: &str, says: &str| {
        std::fs::write(&path, text_of_it).unwrap();
        fail(&["replay", text(&scene.occ), "--path", text(&path)], 65, says);
    };
    fail(
        &["replay", text(&scene.occ), "--path", text(&scene.file("absent.csv"))],
        66,
        "absent.csv",
    );
    refused("", "bad.csv");
    refused(header, "bad.csv");
    refused("a,b,c\n1,2,3\n", "bad.csv");
    refused(&format!("{header}0,0,0,0,0,1,0,1,0,60\nNaN,0,0,0,0,1,0,1,0,60\n"), "line 3");
    refused(&format!("{header}0,0,0,0,0,1,0,1,0\n"), "line 2");
    refused(&format!("{header}1,1,1,1,1,1,0,1,0,60\n"), "line 2");
}

#[test]
fn a_bad_command_line_or_configuration_says_what_would_be_right() {
    let scene = Scene::synth("pipes", 50_000);
    fail(&["replay"], 2, "SCENE.occ");
    fail(&["replay", text(&scene.occ), "--size", "big"], 2, "WIDTHxHEIGHT");
    fail(&["replay", text(&scene.occ), "--processes", "2"], 2, "1 or 3");
    fail(&["replay", text(&scene.occ), "--cull", "zap"], 2, "queries");
    fail(&["replay", text(&scene.occ), "--lod", "-1"], 2, "");
    fail(&["replay", text(&scene.occ), "--pictures", "png"], 2, "--out");
    let rig = scene.file("rig.toml");
    std::fs::write(&rig, "procesess = 3").unwrap();
    fail(&["replay", text(&scene.occ), "--rig", text(&rig)], 78, "procesess");
    fail(
        &["replay", text(&scene.occ), "--rig", text(&scene.file("absent.toml"))],
        78,
        "absent.toml",
    );
    fail(
        &["bake", text(&scene.occ), "-o", text(&scene.file("x.occ")), "--config", text(&rig)],
        78,
        "procesess",
    );
    let bake = |memory: &str, code, says: &str| {
        let output = scene.file("x.occ");
        let (source, output) = (text(&scene.occ), text(&output));
        fail(&["bake", source, "-o", output, "--memory", memory], code, says);
        assert!(!Path::new(output).exists());
    };
    bake("plenty", 2, "64MiB");
    bake("5 MB", 2, "64MiB");
    bake("99999999999TiB", 2, "bytes");
    bake("1MiB", 78, "16MiB");
    fail(&["bake", "-o", text(&scene.file("x.occ"))], 2, "INPUT");
}

#[test]
fn a_taken_port_is_named() {
    let scene = Scene::synth("pipes", 50_000);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let rig = scene.file("rig.toml");
    std::fs::write(&rig, format!("bind = \"{address}\"")).unwrap();
    fail(&["replay", text(&scene.occ), "--rig", text(&rig), "--backend", "cpu"], 69, &address);
}

#[test]
fn a_node_without_a_coordinator_or_a_token_says_so() {
    let free =
        std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let node = |stdin: &str| {
        let folder = TempDir::new().unwrap();
        let input = write(&folder, "stdin", stdin.as_bytes());
        let file = std::fs::File::open(input).unwrap();
        let output = occluster()
            .args(["node", "--join", &free, "--token-stdin"])
            .stdin(file)
            .output()
            .unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, says) = node("not a token\n");
    assert_eq!(code, Some(77), "{says}");
    let (code, says) = node(&format!("{}\n", "ab".repeat(32)));
    assert_eq!(code, Some(69), "{says}");
}

#[test]
fn a_reader_that_has_gone_away_is_no_reason_to_panic() {
    let mut command = occluster();
    let mut doctor =
        command.arg("doctor").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(doctor.stdout.take());
    let output = doctor.wait_with_output().unwrap();
    let says = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(74), "{says}");
    assert!(!says.contains("panicked") && !says.contains("occluster:"), "{says}");
}
