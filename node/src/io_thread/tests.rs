//! The thread against sources that are slow, broken, or too large for its buffers.

use super::*;
use crate::fixture::{street, write};
use protocol::camera::Camera;
use protocol::settings::PictureSize;
use protocol::visible::VisibleSet;
use std::sync::Mutex;
use std::time::Duration;

const SIZE: PictureSize = PictureSize { width: 64, height: 48 };

/// The skeleton of the street, as if it had `blobs` meshes of `bytes` each.
fn skeleton(blobs: u32, bytes: u64) -> Arc<Skeleton> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    write(&path, &street(), false);
    let mut skeleton = Skeleton::clone(Store::open(&path).unwrap().skeleton());
    skeleton.blobs = vec![protocol::format::Blob { bytes, ..skeleton.blobs[0] }; blobs as usize];
    for (part, place) in skeleton.parts.iter_mut().zip(0..) {
        part.blob = place % blobs;
    }
    Arc::new(skeleton)
}

/// Fills a blob with its id; some cannot be read.
struct Fake {
    pause: Duration,
    broken: Option<BlobId>,
    read: Arc<Mutex<Vec<BlobId>>>,
}

impl Source for Fake {
    fn read(&self, blob: BlobId, out: &mut [u8]) -> Result<(), StoreError> {
        std::thread::sleep(self.pause);
        self.read.lock().unwrap().push(blob);
        out.fill(blob.0 as u8);
        match self.broken {
            Some(broken) if broken == blob => {
                Err(StoreError::Unknown { path: "fake.occ".into(), blob })
            }
            _ => Ok(()),
        }
    }
}

fn start(
    skeleton: &Arc<Skeleton>,
    cap: u64,
    pause: Duration,
) -> (IoThread, Arc<Mutex<Vec<BlobId>>>) {
    let read = Arc::default();
    let source = Fake { pause, broken: Some(BlobId(7)), read: Arc::clone(&read) };
    let forecaster = Forecaster::new(Arc::clone(skeleton), Arc::default(), SIZE, 0.0);
    (IoThread::start(source, Arc::clone(skeleton), forecaster, None, cap).unwrap(), read)
}

fn everything(skeleton: &Skeleton) -> Order {
    Order::Everything((0..skeleton.blobs.len() as u32).map(BlobId).collect())
}

fn wait(io: &IoThread) -> Arrival {
    io.arrivals.recv_timeout(Duration::from_secs(20)).unwrap()
}

fn outlook() -> Outlook {
    let now =
        Camera::look_at([10.0, -3.0, 2.0], [11.0, 6.0, 2.0], [0.0, 0.0, 1.0], 60.0, 0.05).unwrap();
    let visible = Arc::new(VisibleSet::whole_scene());
    Outlook { drawn: None, ahead: vec![now], visible }
}

#[test]
fn what_is_fetched_comes_in_order_and_once() {
    let skeleton = skeleton(9, 100);
    let (io, read) = start(&skeleton, 1000, Duration::ZERO);
    io.fetch([3, 1, 7, 3, 2].map(BlobId).to_vec());
    for (blob, is_good) in [(3, true), (1, true), (7, false), (2, true)] {
        let arrival = wait(&io);
        assert_eq!((arrival.blob, arrival.foreseen), (BlobId(blob), false));
        assert_eq!(arrival.bytes.is_ok(), is_good);
        if let Ok(bytes) = arrival.bytes {
            assert_eq!(bytes[..], [blob as u8; 100]);
        }
    }
    // Claimed until it is given up.
    io.fetch(vec![BlobId(1)]);
    io.fetch(vec![BlobId(4)]);
    assert_eq!(wait(&io).blob, BlobId(4));
    io.claims.clear(BlobId(1));
    io.fetch(vec![BlobId(1)]);
    assert_eq!(wait(&io).blob, BlobId(1));
    assert_eq!(read.lock().unwrap().len(), 6);
}

#[test]
fn with_room_for_one_buffer_all_comes_one_by_one() {
    let skeleton = skeleton(200, 100);
    let (io, _) = start(&skeleton, 199, Duration::ZERO);
    io.fetch((0..200).map(BlobId).collect());
    for blob in 0..200 {
        let arrival = wait(&io);
        assert_eq!(arrival.blob, BlobId(blob));
        // What cannot be read takes no room.
        if arrival.bytes.is_ok() {
            assert!(io.arrivals.recv_timeout(Duration::from_millis(1)).is_err(), "no room for two");
        }
        drop(arrival);
    }
    assert!(io.pool.most() <= 199);
}

#[test]
fn a_fetch_command_goes_before_what_is_read_ahead() {
    let skeleton = skeleton(60, 100);
    let (io, _) = start(&skeleton, 200, Duration::from_millis(1));
    io.foresee(everything(&skeleton));
    let first = wait(&io);
    assert!(first.foreseen);
    io.fetch(vec![BlobId(55)]);
    drop(first);
    // Two buffers are full of what was read ahead before the command came, one may be on its way.
    let before = std::iter::from_fn(|| Some(wait(&io))).take_while(|arrival| arrival.blob.0 != 55);
    assert!(before.map(drop).count() <= 3);
    let rest = std::iter::from_fn(|| io.arrivals.recv_timeout(Duration::from_secs(2)).ok());
    assert!(rest.map(drop).count() >= 55, "and then it goes on");
}

#[test]
fn no_more_is_read_ahead_than_there_is_room_for() {
    let skeleton = skeleton(60, 100);
    let (io, read) = start(&skeleton, 10_000, Duration::ZERO);
    io.foresee(Order::Foresee { outlook: outlook(), in_use: vec![], room: 350 });
    let foreseen: Vec<Arrival> =
        std::iter::from_fn(|| io.arrivals.recv_timeout(Duration::from_millis(300)).ok()).collect();
    assert_eq!(foreseen.len(), 3);
    assert!(foreseen.iter().all(|arrival| arrival.foreseen));
    io.foresee(Order::Foresee { outlook: outlook(), in_use: vec![], room: 0 });
    assert!(io.arrivals.recv_timeout(Duration::from_millis(100)).is_err());
    assert_eq!(read.lock().unwrap().len(), 3);
}

#[test]
fn orders_are_taken_while_nobody_takes_arrivals_in() {
    let skeleton = skeleton(200, 10);
    let (io, _) = start(&skeleton, 100_000, Duration::ZERO);
    io.foresee(everything(&skeleton));
    // Far more than fit the queue, while the arrivals' queue is full: none of these may block.
    for blob in (100..200).rev() {
        io.fetch(vec![BlobId(blob)]);
    }
    let all = std::iter::from_fn(|| io.arrivals.recv_timeout(Duration::from_secs(2)).ok());
    assert_eq!(all.map(drop).count(), 200);
}

#[test]
fn it_ends_with_its_handle_even_while_it_waits() {
    let skeleton = skeleton(200, 100);
    for cap in [100, 100_000] {
        let (io, read) = start(&skeleton, cap, Duration::ZERO);
        io.foresee(everything(&skeleton));
        let held = wait(&io);
        drop(io);
        drop(held);
        let gone = (0..1000).any(|_| {
            std::thread::sleep(Duration::from_millis(5));
            Arc::strong_count(&read) == 1
        });
        assert!(gone, "the thread goes on");
    }
}
