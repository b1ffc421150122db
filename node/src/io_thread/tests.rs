//! The thread against sources that are slow, broken, or too large for its buffers.

use super::*;
use crate::fixture::{street, write};
use protocol::camera::Camera;
use protocol::id::BlobId;
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
    broken: Option<Asset>,
    read: Arc<Mutex<Vec<Asset>>>,
}

impl Source for Fake {
    fn read(&self, asset: Asset, out: &mut [u8]) -> Result<(), StoreError> {
        std::thread::sleep(self.pause);
        self.read.lock().unwrap().push(asset);
        out.fill(asset.index(0) as u8);
        match self.broken {
            Some(broken) if broken == asset => {
                Err(StoreError::Unknown { path: "fake.occ".into(), blob: BlobId(7) })
            }
            _ => Ok(()),
        }
    }
}

fn start(
    skeleton: &Arc<Skeleton>,
    cap: u64,
    pause: Duration,
) -> (IoThread, Arc<Mutex<Vec<Asset>>>) {
    let read = Arc::default();
    let source = Fake { pause, broken: Some(blob(7)), read: Arc::clone(&read) };
    let forecaster = Forecaster::new(Arc::clone(skeleton), Arc::default(), SIZE, 0.0);
    (IoThread::start(source, Arc::clone(skeleton), forecaster, None, [cap, 100]).unwrap(), read)
}

fn blob(id: u32) -> Asset {
    Asset::Blob(BlobId(id))
}

/// A forecast that names all that can be seen, in `bytes` of room.
fn forecast(bytes: u64) -> Order {
    let room = Room { blobs: bytes, textures: 0 };
    Order::Foresee { outlook: outlook(), in_use: vec![], room, textures: false }
}

fn wait(io: &IoThread) -> Arrival {
    io.arrivals.recv_timeout(Duration::from_secs(20)).unwrap()
}

fn outlook() -> Outlook {
    let now =
        Camera::look_at([10.0, -3.0, 2.0], [11.0, 6.0, 2.0], [0.0, 0.0, 1.0], 60.0, 0.05).unwrap();
    let visible = Arc::new(VisibleSet::from_sorted(vec![protocol::id::HlodId(0)]));
    Outlook { drawn: None, ahead: vec![now], visible }
}

#[test]
fn what_is_fetched_comes_in_order_and_once() {
    let skeleton = skeleton(9, 100);
    let (io, read) = start(&skeleton, 1000, Duration::ZERO);
    io.fetch([3, 1, 7, 3, 2].map(blob).to_vec(), true);
    for (id, is_good) in [(3, true), (1, true), (7, false), (2, true)] {
        let arrival = wait(&io);
        assert_eq!((arrival.asset, arrival.foreseen), (blob(id), false));
        assert_eq!(arrival.bytes.is_ok(), is_good);
        if let Ok(bytes) = arrival.bytes {
            assert_eq!(bytes[..], [id as u8; 100]);
        }
    }
    // Claimed until it is given up.
    io.fetch(vec![blob(1)], false);
    io.fetch(vec![blob(4)], false);
    assert_eq!(wait(&io).asset, blob(4));
    io.claims.clear(blob(1));
    io.fetch(vec![blob(1)], false);
    assert_eq!(wait(&io).asset, blob(1));
    assert_eq!(read.lock().unwrap().len(), 6);
}

#[test]
fn with_room_for_one_buffer_all_comes_one_by_one() {
    let skeleton = skeleton(200, 100);
    let (io, _) = start(&skeleton, 199, Duration::ZERO);
    io.fetch((0..200).map(blob).collect(), true);
    for id in 0..200 {
        let arrival = wait(&io);
        assert_eq!(arrival.asset, blob(id));
        // What cannot be read takes no room.
        if arrival.bytes.is_ok() {
            assert!(io.arrivals.recv_timeout(Duration::from_millis(1)).is_err(), "no room for two");
        }
        drop(arrival);
    }
    assert!(io.pool.most() <= 199);
}

#[test]
fn a_fetch_command_goes_before_what_is_read_ahead_and_has_room_of_its_own() {
    let skeleton = skeleton(60, 100);
    let (io, _) = start(&skeleton, 300, Duration::from_millis(1));
    io.foresee(forecast(10_000));
    let ahead: Vec<Arrival> = (0..2).map(|_| wait(&io)).collect();
    assert!(ahead.iter().all(|arrival| arrival.foreseen));
    // Two of three buffers hold what was read ahead, and that is all it may have.
    assert!(io.arrivals.recv_timeout(Duration::from_millis(50)).is_err());
    io.fetch(vec![blob(55)], true);
    let arrival = wait(&io);
    assert_eq!((arrival.asset, arrival.foreseen), (blob(55), false));
    drop((ahead, arrival));
    let rest = std::iter::from_fn(|| io.arrivals.recv_timeout(Duration::from_secs(2)).ok());
    let rest = rest.map(drop).count();
    assert!(rest >= 10, "and then it goes on: {rest}");
}

#[test]
fn what_another_drawing_lacks_takes_the_place_of_what_the_last_one_ordered() {
    let skeleton = skeleton(700, 100);
    let (io, read) = start(&skeleton, 100_000, Duration::from_millis(2));
    // Three drawings far from each other; the second orders in two pieces, and some twice.
    io.fetch((100..300).map(blob).collect(), true);
    io.fetch((300..400).map(blob).collect(), true);
    io.fetch((350..500).map(blob).collect(), false);
    io.fetch((500..700).map(blob).collect(), true);
    let left = |arrival: &Arrival| arrival.asset != blob(699);
    let come = std::iter::from_fn(|| Some(wait(&io))).take_while(left).count();
    // The thread may have begun one of each before it heard of the next.
    assert!(come <= 199 + 3, "{come} came before the last that is lacked");
    assert!(io.arrivals.recv_timeout(Duration::from_millis(100)).is_err(), "leftovers are read");
    let read = read.lock().unwrap();
    let distinct: BTreeSet<_> = read.iter().collect();
    assert_eq!(distinct.len(), read.len(), "something was read twice");
    assert!((500..700).all(|id| distinct.contains(&blob(id))));
}

#[test]
fn a_drawing_that_orders_again_and_again_waits_for_no_more_than_it_lacks() {
    let skeleton = skeleton(60, 100);
    let (io, read) = start(&skeleton, 100_000, Duration::from_millis(1));
    for _ in 0..20 {
        io.fetch((10..60).map(blob).collect(), false);
    }
    let all = std::iter::from_fn(|| io.arrivals.recv_timeout(Duration::from_millis(300)).ok());
    assert_eq!((all.count(), read.lock().unwrap().len()), (50, 50));
}

#[test]
fn no_more_is_read_ahead_than_there_is_room_for() {
    let skeleton = skeleton(60, 100);
    let (io, read) = start(&skeleton, 10_000, Duration::ZERO);
    io.foresee(forecast(350));
    let foreseen: Vec<Arrival> =
        std::iter::from_fn(|| io.arrivals.recv_timeout(Duration::from_millis(300)).ok()).collect();
    assert_eq!(foreseen.len(), 3);
    assert!(foreseen.iter().all(|arrival| arrival.foreseen));
    io.foresee(forecast(0));
    assert!(io.arrivals.recv_timeout(Duration::from_millis(100)).is_err());
    assert_eq!(read.lock().unwrap().len(), 3);
}

#[test]
fn of_what_may_as_well_be_hidden_a_forecast_reads_a_part() {
    const MIB: u64 = 1 << 20;
    let skeleton = skeleton(60, MIB);
    let (io, read) = start(&skeleton, 64 * MIB, Duration::ZERO);
    let come = || {
        let arrivals =
            std::iter::from_fn(|| io.arrivals.recv_timeout(Duration::from_millis(300)).ok());
        arrivals.map(drop).count() as u64
    };
    let guess = || {
        let outlook = Outlook { visible: Arc::default(), ..outlook() };
        let room = Room { blobs: u64::MAX, textures: 0 };
        Order::Foresee { outlook, in_use: vec![], room, textures: false }
    };
    for turn in 1..4 {
        io.foresee(guess());
        assert_eq!(come(), GUESSED_BYTES / MIB);
        let distinct: BTreeSet<Asset> = read.lock().unwrap().iter().copied().collect();
        assert_eq!(distinct.len() as u64, turn * GUESSED_BYTES / MIB, "each reads on");
    }
    // What stands for the visible set is no guess.
    io.foresee(forecast(u64::MAX));
    assert!(come() > 3 * GUESSED_BYTES / MIB);
}

#[test]
fn what_is_larger_than_a_drawing_takes_in_besides_is_not_read_ahead() {
    let skeleton = skeleton(3, BESIDES_BYTES + 1);
    let (io, read) = start(&skeleton, 8 * BESIDES_BYTES, Duration::ZERO);
    io.foresee(forecast(u64::MAX));
    assert!(io.arrivals.recv_timeout(Duration::from_millis(100)).is_err());
    io.fetch(vec![blob(1)], true);
    assert_eq!(wait(&io).asset, blob(1));
    assert_eq!(read.lock().unwrap().len(), 1);
}

#[test]
fn orders_are_taken_while_nobody_takes_arrivals_in() {
    let skeleton = skeleton(2000, 10);
    let (io, _) = start(&skeleton, 100_000, Duration::ZERO);
    io.fetch((1000..2000).map(blob).collect(), true);
    // Far more than fit the queue, while the arrivals' queue is full: none of these may block.
    for id in (500..1000).rev() {
        io.fetch(vec![blob(id)], false);
    }
    let all = std::iter::from_fn(|| io.arrivals.recv_timeout(Duration::from_secs(2)).ok());
    assert_eq!(all.map(drop).count(), 1500);
}

#[test]
fn it_ends_with_its_handle_even_while_it_waits() {
    let skeleton = skeleton(200, 100);
    for cap in [200, 100_000] {
        let (io, read) = start(&skeleton, cap, Duration::ZERO);
        io.foresee(forecast(100_000));
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
