use super::*;
use crate::deep::{DeepError, Effort, deep};
use crate::fixture;
use crate::verify::{VerifyError, verify};
use std::fs::OpenOptions;
use std::io::{Seek, SeekFrom, Write};
use tempfile::TempDir;

/// Blobs of the large scene, a MiB each.
const LARGE: u32 = 32;

fn large() -> (TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.occ");
    fixture::write_large(&path, LARGE);
    let store = Store::open(&path).unwrap();
    (folder, store)
}

fn writable(store: &Store) -> File {
    OpenOptions::new().write(true).open(store.path()).unwrap()
}

/// Changes the file in place.
fn overwrite(store: &Store, at: u64, bytes: &[u8]) {
    let mut file = writable(store);
    file.seek(SeekFrom::Start(at)).unwrap();
    file.write_all(bytes).unwrap();
}

fn ids(store: &Store) -> impl Iterator<Item = BlobId> + use<> {
    (0..store.skeleton().blobs.len() as u32).map(BlobId)
}

/// Every blob as it lies in a copy of the file.
fn holds_what(store: &Store, file: &[u8]) -> bool {
    ids(store).all(|id| {
        let range = store.range(Content::Blob(id));
        store.load_blob(id).unwrap() == file[range.start as usize..range.end as usize]
    })
}

/// A blob of a shortened file is gone, and the error says whose.
fn assert_gone(store: &Store, id: BlobId) {
    let error = store.load_blob(id).map(drop).unwrap_err();
    let (path, content) = (store.path().to_path_buf(), Content::Blob(id));
    assert_eq!(error, StoreError::Gone { path, content });
    assert!(error.to_string().contains(&format!(".occ: blob {id} is gone")), "{error}");
    assert_eq!(error.kind(), FailureKind::BadData);
}

#[test]
fn openings_fail_by_kind_and_name_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let kind = |path: &Path| {
        let error = Store::open(path).unwrap_err();
        assert!(error.to_string().contains(&path.display().to_string()), "{error}");
        failure_kind(&error)
    };
    assert_eq!(kind(&path), FailureKind::NoInput);
    assert_eq!(kind(folder.path()), FailureKind::Io);
    for contents in [&b""[..], b"solid teapot", &[0; 300]] {
        std::fs::write(&path, contents).unwrap();
        assert_eq!(kind(&path), FailureKind::BadData);
    }
    fixture::write(&path);
    let bytes = std::fs::read(&path).unwrap();
    for length in 1..bytes.len() {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert_eq!(kind(&path), FailureKind::BadData, "cut to {length}");
    }
}

#[test]
fn what_is_read_is_what_the_file_holds() {
    for (_folder, store) in [fixture::store(), large()] {
        let file = std::fs::read(store.path()).unwrap();
        assert_eq!(store.bytes(), file.len() as u64);
        assert!(holds_what(&store, &file));
        let texture = store.range(Content::Texture(0));
        let expected = &file[texture.start as usize..texture.end as usize];
        assert_eq!(store.load_texture(0).unwrap(), expected);
        assert_eq!(store.real_digest().unwrap(), store.digest());
    }
}

#[test]
fn a_blob_that_does_not_exist_is_our_own_mistake() {
    let (_folder, store) = fixture::store();
    let unknown = store.load_blob(BlobId(99)).map(drop).unwrap_err();
    assert_eq!(unknown.kind(), FailureKind::Internal);
    assert!(unknown.to_string().contains("no blob 99"), "{unknown}");
}

#[test]
#[should_panic(expected = "room for blob 0")]
fn a_buffer_of_another_length_is_our_own_mistake() {
    let (_folder, store) = fixture::store();
    let _ = store.read_blob(BlobId(0), &mut [0; 3]);
}

#[test]
fn every_byte_that_changes_in_place_is_found_at_the_next_reading() {
    let (_folder, store) = fixture::store();
    let sound = std::fs::read(store.path()).unwrap();
    for content in ids(&store).map(Content::Blob).chain([Content::Texture(0)]) {
        let read = || match content {
            Content::Blob(id) => store.load_blob(id).map(|_| ()),
            _ => store.load_texture(0).map(|_| ()),
        };
        for at in store.range(content) {
            read().unwrap();
            overwrite(&store, at, &[sound[at as usize] ^ 1]);
            let error = read().unwrap_err();
            assert!(error.to_string().contains(&format!("scene.occ: {content} is damaged")));
            assert_eq!(error.kind(), FailureKind::BadData);
            overwrite(&store, at, &sound[at as usize..][..1]);
        }
    }
    assert!(holds_what(&store, &sound));
}

#[test]
fn a_file_cut_short_loses_what_lay_behind_the_cut_and_no_more() {
    let (_folder, store) = large();
    let sound = std::fs::read(store.path()).unwrap();
    let victim = BlobId(LARGE / 2);
    let range = store.range(Content::Blob(victim));
    let page = (range.start + range.end) / 2 / 4096 * 4096;
    // In the blob's last page, behind which it has but zeros, within one and on its border.
    for cut in [range.end - 4, page + 5, page, range.start + 1, range.start] {
        writable(&store).set_len(cut).unwrap();
        for id in ids(&store) {
            if id < victim {
                store.load_blob(id).unwrap();
            } else {
                assert_gone(&store, id);
            }
        }
        let gone = StoreError::Gone { path: store.path().to_path_buf(), content: Content::Whole };
        assert_eq!(store.real_digest().unwrap_err(), gone);
        assert!(matches!(store.load_texture(0), Err(StoreError::Gone { .. })));
    }
    writable(&store).set_len(0).unwrap();
    ids(&store).for_each(|id| assert_gone(&store, id));

    // As long as before, but zeros: there are bytes again, and they are wrong.
    writable(&store).set_len(sound.len() as u64).unwrap();
    for id in ids(&store) {
        assert!(matches!(store.load_blob(id), Err(StoreError::Damaged { .. })));
    }
    overwrite(&store, 0, &sound);
    assert!(holds_what(&store, &sound));
}

#[test]
fn a_cut_within_the_only_page_is_told_from_damage() {
    let (_folder, store) = fixture::store();
    let range = store.range(Content::Blob(BlobId(1)));
    // Its last bytes may be zeros anyway.
    writable(&store).set_len(range.end - 12).unwrap();
    store.load_blob(BlobId(0)).unwrap();
    assert_gone(&store, BlobId(1));
    let texture = store.load_texture(0).unwrap_err();
    let (path, content) = (store.path().to_path_buf(), Content::Texture(0));
    assert_eq!(texture, StoreError::Gone { path, content });
}

#[test]
fn whoever_reads_everything_of_a_file_cut_short_hears_of_it() {
    let gone = |store: &Store, id| {
        let content = Content::Blob(id);
        writable(store).set_len(store.range(content).start).unwrap();
        StoreError::Gone { path: store.path().to_path_buf(), content }
    };
    let (_folder, store) = large();
    let first = gone(&store, BlobId(3));
    assert_eq!(verify(&store), Err(VerifyError::Blob(first)));
    let (_folder, store) = fixture::store();
    let coarse = gone(&store, BlobId(1));
    assert_eq!(deep(&store, &Effort::default()), Err(DeepError::Blob(coarse)));
}

#[test]
fn a_file_replaced_by_rename_stays_what_it_was() {
    let (folder, store) = fixture::store();
    let before = std::fs::read(store.path()).unwrap();
    let finished = fixture::write_other(store.path());
    assert_ne!(finished.digest, store.digest());
    assert!(holds_what(&store, &before));
    assert_eq!(verify(&store).map(|verified| verified.meshes), Ok(2));
    assert_eq!(Store::open(store.path()).unwrap().digest(), finished.digest);
    drop(folder);
    assert!(holds_what(&store, &before));
}

#[test]
fn a_file_replaced_in_place_is_damaged() {
    let (_folder, store) = large();
    overwrite(&store, 0, &vec![0x5a; store.bytes() as usize]);
    for id in ids(&store) {
        let error = store.load_blob(id).map(drop).unwrap_err();
        assert!(matches!(error, StoreError::Damaged { blob, .. } if blob == id), "{error}");
    }
    assert!(matches!(store.load_texture(0), Err(StoreError::DamagedTexture { .. })));
}

#[test]
fn an_input_error_names_what_was_read_and_is_no_damage() {
    let (_folder, store) = fixture::store();
    let error = store.unread(Content::Texture(7), io::Error::other("the cable is loose"));
    assert_eq!(error.kind(), FailureKind::Io);
    let said = error.to_string();
    assert!(said.contains("scene.occ: cannot read texture 7: the cable is loose"), "{said}");
}

#[test]
fn threads_read_at_once() {
    let (_folder, store) = large();
    let file = std::fs::read(store.path()).unwrap();
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| assert!(holds_what(&store, &file)));
        }
    });
}

/// Bytes of the store's map that are resident in this process.
#[cfg(target_os = "linux")]
fn resident_bytes(store: &Store) -> u64 {
    let maps = std::fs::read_to_string("/proc/self/smaps").unwrap();
    let path = store.path().to_str().unwrap();
    let own = maps.lines().skip_while(|line| !line.ends_with(path));
    let rss = own.skip(1).find_map(|line| line.strip_prefix("Rss:")).unwrap();
    rss.trim().trim_end_matches(" kB").parse::<u64>().unwrap() << 10
}

#[test]
#[cfg(target_os = "linux")]
fn little_of_what_was_read_stays_resident() {
    let (_folder, store) = large();
    let mut out = vec![0; store.skeleton().blobs[0].bytes as usize];
    // In file order, from both ends, and by steps that leave nothing beside the last.
    let orders = [|i| i, |i| if i % 2 == 0 { i / 2 } else { LARGE - 1 - i / 2 }, |i| i * 7 % LARGE];
    for order in orders {
        for i in 0..LARGE {
            store.read_blob(BlobId(order(i)), &mut out).unwrap();
            let resident = resident_bytes(&store);
            assert!(resident <= 5 << 20, "{resident} of {} bytes", store.bytes());
        }
    }
}
