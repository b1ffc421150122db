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

/// Runs the program and expects this exit code soon, and a message without a panic.
#[cfg(unix)]
fn fail_soon(arguments: &[&str], code: i32) {
    let program = occluster();
    let mut command = std::process::Command::new("timeout");
    command.arg("20").arg(program.get_program()).args(arguments);
    let output = command.output().unwrap();
    let says = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {says}");
    assert!(says.contains("occluster: ") && !says.contains("panicked"), "{arguments:?}: {says}");
}

#[cfg(unix)]
fn pipe(folder: &TempDir, name: &str) -> PathBuf {
    let path = folder.path().join(name);
    assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
    path
}

#[test]
#[cfg(unix)]
fn no_output_takes_the_place_of_an_input() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let glb = write(&folder, "a.glb", &triangle(|json| json, GOOD));
    let gltf =
        r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":36,"uri":"a.bin"}]}"#.as_bytes();
    let (gltf, bin) = (write(&folder, "b.gltf", gltf), write(&folder, "a.bin", &[0; 36]));
    let config = write(&folder, "bake.toml", b"");
    std::fs::hard_link(&glb, at("hard.occ")).unwrap();
    std::os::unix::fs::symlink("a.glb", at("soft.occ")).unwrap();
    let refused = |arguments: &[&str], input: &Path| {
        let before = (std::fs::read(input).unwrap(), names(folder.path()));
        fail(arguments, 2, text(input));
        assert!(before == (std::fs::read(input).unwrap(), names(folder.path())), "{arguments:?}");
    };
    for output in ["a.glb", "./a.glb", "hard.occ", "soft.occ"] {
        refused(&["bake", text(&glb), "-o", text(&at(output))], &glb);
        refused(&["bake", text(&gltf), text(&glb), "-o", text(&at(output))], &glb);
    }
    refused(&["bake", text(&gltf), "-o", text(&bin)], &bin);
    refused(&["bake", text(&glb), "-o", text(&config), "--config", text(&config)], &config);
    refused(&["synth", "town", "--from", text(&glb), "-o", text(&glb)], &glb);

    let occ = at("a.occ");
    succeed(&["bake", text(&glb)]);
    refused(&["bake", text(&occ), "--far", "tdm"], &occ);
    refused(&["path", text(&occ), "-o", text(&occ)], &occ);
    let walk = at("frames.csv");
    succeed(&["path", text(&occ), "-o", text(&walk), "--frames", "2"]);
    let out = ["--out", text(folder.path())];
    refused(&[&["replay", text(&occ), "--path", text(&walk)][..], &out].concat(), &walk);
    fail(&["bake", text(&glb), text(&gltf)], 2, "-o");
}

#[test]
#[cfg(unix)]
fn no_output_takes_the_place_of_what_is_no_file() {
    let folder = TempDir::new().unwrap();
    let glb = write(&folder, "a.glb", &triangle(|json| json, GOOD));
    let occ = folder.path().join("a.occ");
    succeed(&["bake", text(&glb), "-o", text(&occ)]);
    let pipe = pipe(&folder, "pipe");
    let dangling = folder.path().join("dangling");
    std::os::unix::fs::symlink("nothing", &dangling).unwrap();
    for output in [&pipe, &dangling] {
        let before = std::fs::symlink_metadata(output).unwrap().file_type();
        fail_soon(&["bake", text(&glb), "-o", text(output)], 74);
        fail_soon(&["path", text(&occ), "-o", text(output)], 74);
        fail_soon(&["synth", "pipes", "--triangles", "100", "-o", text(output)], 74);
        assert_eq!(std::fs::symlink_metadata(output).unwrap().file_type(), before);
    }
    // Where a link leads to a file, that one is written.
    let (real, link) = (folder.path().join("real.occ"), folder.path().join("link.occ"));
    std::fs::write(&real, "old").unwrap();
    std::os::unix::fs::symlink("real.occ", &link).unwrap();
    succeed(&["bake", text(&glb), "-o", text(&link)]);
    assert!(link.is_symlink() && std::fs::read(&real).unwrap() == std::fs::read(&occ).unwrap());
}

#[test]
#[cfg(unix)]
fn what_is_no_file_is_not_waited_for() {
    let scene = Scene::synth("pipes", 3_000);
    let folder = TempDir::new().unwrap();
    let zeros = folder.path().join("zeros.stl");
    std::os::unix::fs::symlink("/dev/zero", &zeros).unwrap();
    let dangling = folder.path().join("dangling.obj");
    std::os::unix::fs::symlink("nothing", &dangling).unwrap();
    let output = scene.file("never.occ");
    for (input, missing) in [(&pipe(&folder, "a.obj"), 74), (&zeros, 74), (&dangling, 66)] {
        let (input, no_rig) = (text(input), 78);
        fail_soon(&["bake", input, "-o", text(&output)], missing);
        fail_soon(&["bake", text(&scene.occ), "-o", text(&output), "--config", input], no_rig);
        for verb in ["inspect", "verify", "replay"] {
            fail_soon(&[verb, input], missing);
        }
        fail_soon(&["replay", text(&scene.occ), "--path", input], 66);
        fail_soon(&["replay", text(&scene.occ), "--rig", input], no_rig);
    }
    assert!(!output.exists());
}

#[test]
#[cfg(unix)]
fn names_need_not_be_utf8() {
    use std::os::unix::ffi::OsStrExt;
    let folder = TempDir::new().unwrap();
    let at = |name: &[u8]| folder.path().join(std::ffi::OsStr::from_bytes(name));
    let (glb, occ, out) = (at(b"geb\xe4ude.glb"), at(b"geb\xe4ude.occ"), at(b"l\xe4ufe"));
    std::fs::write(&glb, triangle(|json| json, GOOD)).unwrap();
    let run = |command: &mut std::process::Command| {
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    run(occluster().arg("bake").arg(&glb).arg("-o").arg(&occ));
    let run_of = ["--backend", "cpu", "--size", "32x32", "--frames", "3", "--pictures", "png"];
    run(occluster().arg("replay").arg(&occ).args(run_of).arg("--out").arg(&out));
    assert_eq!(std::fs::read_dir(out.join("frames")).unwrap().count(), 3);
}

#[test]
fn a_field_of_view_that_shows_nothing_is_refused() {
    let scene = Scene::synth("pipes", 3_000);
    let path = scene.file("bad.csv");
    for fov in ["1e-44", "1e-30", "1e-7", "179.9999999"] {
        let header =
            "eye_x,eye_y,eye_z,target_x,target_y,target_z,up_x,up_y,up_z,fov_y_deg".to_owned();
        std::fs::write(&path, header + "\n40,10,20,41,10,20,0,1,0," + fov + "\n").unwrap();
        fail(&["replay", text(&scene.occ), "--path", text(&path)], 65, "line 2");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_stderr_that_takes_nothing_changes_no_exit_code() {
    let scene = Scene::synth("pipes", 3_000);
    let full = || std::fs::File::options().write(true).open("/dev/full").unwrap();
    let code = |arguments: &[&str], stderr: Stdio| {
        let status = occluster().args(arguments).stdout(Stdio::null()).stderr(stderr).status();
        status.unwrap().code()
    };
    assert_eq!(code(&["inspect", text(&scene.file("absent.occ"))], full().into()), Some(66));
    let mut bytes = std::fs::read(&scene.occ).unwrap();
    let (damaged, third) = (scene.file("damaged.occ"), bytes.len() / 3);
    bytes[third] ^= 1;
    std::fs::write(&damaged, bytes).unwrap();
    let path = scene.path("orbit", 4);
    for occ in [&scene.occ, &damaged] {
        let replay = ["replay", text(occ), "--path", text(&path), "--backend", "cpu", "-vv"];
        assert_eq!(code(&replay, full().into()), code(&replay, Stdio::null()));
    }
    // Results that cannot be written are a failure, told or not.
    let mut inspect = occluster();
    inspect.args(["inspect", text(&scene.occ)]).stdout(full()).stderr(full());
    assert_eq!(inspect.status().unwrap().code(), Some(74));
}

#[test]
fn a_refused_run_removes_nothing_and_others_files_stay() {
    let scene = Scene::synth("pipes", 3_000);
    let out = scene.file("run");
    let frames = out.join("frames");
    let all = ["replay", text(&scene.occ), "--backend", "cpu", "--size", "16x16", "--out"];
    let replay = |options: &[&'static str]| [&all[..], &[text(&out)], options].concat();
    std::fs::create_dir_all(&frames).unwrap();
    std::fs::write(frames.join("holiday.png"), "mine").unwrap();
    succeed(&replay(&["--frames", "5", "--pictures", "png"]));
    let before = [names(&out), names(&frames)];
    for (options, code) in [(&["--memory", "1"], 78), (&["--far-cubes", "0"], 2)] {
        fail(&replay(options), code, "");
        assert_eq!([names(&out), names(&frames)], before);
    }
    std::fs::write(frames.join("000007.png"), "mine").unwrap();
    std::fs::write(frames.join(".000003.png.12345.tmp"), "half").unwrap();
    succeed(&replay(&["--frames", "2", "--pictures", "png"]));
    let left = ["000000.png", "000001.png", "000007.png", "holiday.png"];
    assert_eq!(names(&frames), left);
}
