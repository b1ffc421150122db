use super::*;
use crate::format::{fixture, parse, read_blob, read_skeleton};

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn what_is_written_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let finished = fixture::write(&path);
    let scene = read_skeleton(&path).unwrap();
    assert_eq!(scene, parse(&std::fs::read(&path).unwrap()).unwrap());
    assert_eq!((scene.digest, scene.file_bytes), (finished.digest, finished.bytes));
    assert_eq!(scene.skeleton.hlods, fixture::hlods());
    assert_eq!(scene.skeleton.levels, fixture::levels());
    assert_eq!(scene.skeleton.transforms, fixture::transforms());
    assert_eq!(scene.skeleton.info, fixture::info());

    let file = File::open(&path).unwrap();
    let wide = read_blob(&file, &scene, BlobId(2)).unwrap();
    let vertices: Vec<_> = mesh::vertices_of(scene.skeleton.blob(BlobId(2)), &wide).collect();
    assert_eq!(vertices, fixture::grid(&[[0, 0, 0], [5, 0, 0], [0, 1, 1]]));
    assert_eq!(names(folder.path()), ["scene.occ"]);
}

#[test]
fn the_same_scene_gives_the_same_bytes() {
    assert_eq!(fixture::bytes(), fixture::bytes());
}

#[test]
fn golden_bytes_hold_the_layout_still() {
    // A change here is a change of the format: raise FORMAT_VERSION and tell FORMAT.md.
    let bytes = fixture::bytes();
    assert_eq!(&bytes[..16], b"\x89OCC\r\n\x1a\n\x01\0\0\0\x04\x03\x02\x01");
    assert_eq!(bytes.len(), GOLDEN_BYTES);
    assert_eq!(blake3::hash(&bytes).to_hex()[..16], *GOLDEN_HASH);
}

const GOLDEN_BYTES: usize = 1280;
const GOLDEN_HASH: &str = "9aec784c8de624b2";

#[test]
fn dropping_removes_the_temporary_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = SceneWriter::create(&folder.path().join("scene.occ")).unwrap();
    fixture::add_blobs(&mut writer);
    assert_eq!(names(folder.path()).len(), 1);
    drop(writer);
    assert_eq!(names(folder.path()), [""; 0]);
}

#[test]
fn a_broken_scene_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    std::fs::write(&path, "kept").unwrap();
    let mut writer = SceneWriter::create(&path).unwrap();
    fixture::add_blobs(&mut writer);
    let error = writer.finish(fixture::info(), fixture::hlods(), Vec::new(), Vec::new());
    let message = error.unwrap_err().to_string();
    assert!(message.contains("scene.occ") && message.contains("hlod 0"), "{message}");
    assert_eq!(names(folder.path()), ["scene.occ"]);
    assert_eq!(std::fs::read(&path).unwrap(), b"kept");
}

#[test]
fn a_missing_folder_and_a_folder_in_the_way_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for path in [folder.path().join("no/scene.occ"), folder.path().to_path_buf()] {
        let error = SceneWriter::create(&path).unwrap_err();
        assert!(matches!(error, WriteError::Create { .. }), "{error}");
        assert!(error.to_string().contains(&path.display().to_string()), "{error}");
    }
}

#[test]
fn a_failed_rename_removes_the_temporary_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let mut writer = SceneWriter::create(&path).unwrap();
    fixture::add_blobs(&mut writer);
    std::fs::create_dir(&path).unwrap();
    let result =
        writer.finish(fixture::info(), fixture::hlods(), fixture::levels(), fixture::transforms());
    assert!(matches!(result, Err(WriteError::Publish { .. })), "{result:?}");
    assert_eq!(names(folder.path()), ["scene.occ"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_that_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let mut writer = SceneWriter::create(&path).unwrap();
    // The device that is always full stands in for the disk.
    let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
    writer.file = BufWriter::with_capacity(16, full);
    let corner = fixture::grid(&[[0, 0, 0], [4, 0, 0], [0, 4, 0]]);
    let error = writer.add_blob([0.0; 3], 0.25, &corner, &[0, 1, 2]).unwrap_err();
    assert!(matches!(&error, WriteError::Write { source, .. }
        if source.kind() == io::ErrorKind::StorageFull));
    assert!(error.to_string().contains("scene.occ"), "{error}");
    drop(writer);
    assert_eq!(names(folder.path()), [""; 0]);
}

#[test]
fn writers_of_one_file_do_not_disturb_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| fixture::write(&path));
        }
    });
    assert_eq!(std::fs::read(&path).unwrap(), fixture::bytes());
    assert_eq!(names(folder.path()), ["scene.occ"]);
}
