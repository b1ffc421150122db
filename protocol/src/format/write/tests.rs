use super::*;
use crate::format::projected::Patch;
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
    assert_eq!(scene.skeleton.parts, fixture::parts());
    assert_eq!(scene.skeleton.transforms, fixture::transforms());
    assert_eq!(scene.skeleton.info, fixture::info());
    assert_eq!(scene.skeleton.view_cells, fixture::view_cells());
    assert_eq!(scene.skeleton.cubes, fixture::cubes());

    let file = File::open(&path).unwrap();
    let wide = read_blob(&file, &scene, BlobId(2)).unwrap();
    let vertices: Vec<_> = mesh::vertices_of(scene.skeleton.blob(BlobId(2)), &wide).collect();
    assert_eq!(vertices, fixture::grid(&[[0, 0, 0], [5, 0, 0], [0, 1, 1]]));
    let leaf = read_blob(&file, &scene, BlobId(3)).unwrap();
    let vertices: Vec<_> =
        mesh::textured_vertices_of(scene.skeleton.blob(BlobId(3)), &leaf).collect();
    assert_eq!(vertices, fixture::leaf());
    let bytes = read_blob(&file, &scene, BlobId(6)).unwrap();
    let (blob, face) = (scene.skeleton.blob(BlobId(6)), fixture::face());
    let read = Patch::of(blob, &bytes);
    assert_eq!((blob.step, read.side, read.table), (face.step, face.side, &[1, 0, 0, 0][..]));
    assert_eq!(read.vertices, bytemuck::cast_slice::<_, u8>(face.vertices));
    assert_eq!((read.indices, read.tiles), (&[0, 0, 1, 0, 2, 0][..], face.tiles.as_flattened()));
    assert_eq!(read.normals, None);
    let bytes = read_blob(&file, &scene, BlobId(5)).unwrap();
    let read = Patch::of(scene.skeleton.blob(BlobId(5)), &bytes);
    assert_eq!((read.tiles, read.normals), (&[0x33; 128][..], Some(&[0x44; 128][..])));
    let [texture] = scene.skeleton.textures[..] else { panic!("one texture") };
    assert_eq!(Wrap::unpack(texture.wrap), Some([Wrap::Repeat, Wrap::Mirror]));
    let range = scene.texture_range(0);
    let pixels = &std::fs::read(&path).unwrap()[range.start as usize..range.end as usize];
    assert_eq!(pixels, texture::mips(2, &fixture::PIXELS));
    assert!(texture.is_made_of(pixels) && !texture.is_made_of(&pixels[1..]));
    assert_eq!(names(folder.path()), ["scene.occ"]);
}

#[test]
fn a_writer_that_is_killed_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (working, path) = (folder.path().join("bake.part"), folder.path().join("scene.occ"));
    let corner = fixture::grid(&[[0, 0, 0], [4, 0, 0], [0, 4, 0]]);
    let add = |writer: &mut SceneWriter| {
        let opaque = Class::OpaqueSingle.all(1);
        writer.add_blob([0.0; 3], 1.0, Vertices::Plain(&corner), &[0, 1, 2], opaque).unwrap();
    };
    let mut writer = SceneWriter::create_at(&working, &path).unwrap();
    let empty = writer.checkpoint().unwrap();
    fixture::add_blobs(&mut writer);
    let state = writer.checkpoint().unwrap();
    assert_eq!((state.blobs.len(), empty.geometry_bytes), (7, 0));
    // What comes after the checkpoint is lost with the process.
    add(&mut writer);
    drop(writer);
    assert_eq!(names(folder.path()), ["bake.part"]);
    for state in [state, empty] {
        let again = state.blobs.is_empty();
        let mut writer = SceneWriter::resume(&working, &path, state).unwrap();
        assert_eq!(writer.checkpoint().unwrap().blobs.len(), if again { 0 } else { 7 });
        if again {
            fixture::add_blobs(&mut writer);
        }
        fixture::add_texture(&mut writer);
        writer.finish(fixture::tables()).unwrap();
        assert_eq!(names(folder.path()), ["scene.occ"]);
        assert_eq!(std::fs::read(&path).unwrap(), fixture::bytes());
        std::fs::rename(&path, &working).unwrap();
    }
}

#[test]
fn a_working_file_that_does_not_fit_its_state_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (working, path) = (folder.path().join("bake.part"), folder.path().join("scene.occ"));
    let mut writer = SceneWriter::create_at(&working, &path).unwrap();
    fixture::add_blobs(&mut writer);
    let state = writer.checkpoint().unwrap();
    drop(writer);
    let bytes = std::fs::read(&working).unwrap();
    let refused = |state: &WriterState| {
        let error = SceneWriter::resume(&working, &path, state.clone()).unwrap_err();
        assert!(error.to_string().contains("bake.part"), "{error}");
        error
    };
    let changed = |change: fn(&mut WriterState)| {
        let mut state = state.clone();
        change(&mut state);
        assert!(matches!(refused(&state), WriteError::Resume { .. }));
    };
    changed(|s| s.geometry_bytes += 64);
    changed(|s| s.blobs.truncate(3));
    changed(|s| s.blobs[1].crc ^= 1);
    changed(|s| s.blobs[1].vertices = u32::MAX);
    changed(|s| s.blobs[0].layout = 9);
    changed(|s| s.blobs[4].image[1] = 1);
    changed(|s| s.blobs[3].image = [0, 0]);
    std::fs::write(&working, &bytes[..bytes.len() - 1]).unwrap();
    assert!(matches!(refused(&state), WriteError::Resume { .. }));
    let mut damaged = bytes.clone();
    damaged[HEADER_BYTES + 3] ^= 1;
    std::fs::write(&working, damaged).unwrap();
    assert!(refused(&state).to_string().contains("blob 0 is damaged"));
    std::fs::remove_file(&working).unwrap();
    assert!(matches!(refused(&state), WriteError::Create { .. }));
    std::fs::write(&working, bytes).unwrap();
    assert!(SceneWriter::resume(&working, &path, state).is_ok());
}

#[test]
#[should_panic(expected = "plain vertices hold no cutoff")]
fn a_mask_of_plain_vertices_is_our_mistake() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = SceneWriter::create(&folder.path().join("scene.occ")).unwrap();
    let corner = fixture::grid(&[[0, 0, 0], [4, 0, 0], [0, 4, 0]]);
    let (vertices, mask) = (Vertices::Plain(&corner), Class::MaskSingle.all(1));
    let _ = writer.add_blob([0.0; 3], 1.0, vertices, &[0, 1, 2], mask);
}

#[test]
fn the_same_scene_gives_the_same_bytes() {
    assert_eq!(fixture::bytes(), fixture::bytes());
}

#[test]
fn golden_bytes_hold_the_layout_still() {
    // A change here is a change of the format: raise FORMAT_VERSION and tell FORMAT.md.
    let bytes = fixture::bytes();
    assert_eq!(&bytes[..16], b"\x89OCC\r\n\x1a\n\x06\0\0\0\x04\x03\x02\x01");
    assert_eq!(bytes.len(), GOLDEN_BYTES);
    assert_eq!(blake3::hash(&bytes).to_hex()[..16], *GOLDEN_HASH);
}

const GOLDEN_BYTES: usize = 3712;
const GOLDEN_HASH: &str = "bfbafa3339646128";

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
    let bare = Tables { info: fixture::info(), hlods: fixture::hlods(), ..Tables::default() };
    let message = writer.finish(bare).unwrap_err().to_string();
    assert!(message.contains("scene.occ") && message.contains("hlod 0"), "{message}");
    assert_eq!(names(folder.path()), ["scene.occ"]);
    assert_eq!(std::fs::read(&path).unwrap(), b"kept");
}

#[test]
fn cells_that_overlap_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = SceneWriter::create(&folder.path().join("scene.occ")).unwrap();
    fixture::add_blobs(&mut writer);
    fixture::add_texture(&mut writer);
    let mut tables = fixture::tables();
    tables.view_cells[1].min[0] = 0.5;
    let message = writer.finish(tables).unwrap_err().to_string();
    assert!(message.contains("view cell 1: it overlaps view cell 0"), "{message}");
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
    fixture::add_texture(&mut writer);
    let result = writer.finish(fixture::tables());
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
    let (vertices, opaque) = (Vertices::Plain(&corner), Class::OpaqueDouble.all(1));
    let error = writer.add_blob([0.0; 3], 0.25, vertices, &[0, 1, 2], opaque).unwrap_err();
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
