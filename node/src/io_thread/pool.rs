//! Buffers for bytes on their way from the file to the backend, under a hard cap.

use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A buffer goes to a request no smaller than this share of it, or is freed.
const LEAST_SHARE: usize = 4;

/// Hands out buffers. Those handed out and those waiting for use again take at most the cap.
#[derive(Debug, Clone)]
pub(crate) struct Pool {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    cap: u64,
    state: Mutex<State>,
    /// Told, without waiting, that a buffer has come back.
    returned: crossbeam_channel::Sender<()>,
}

#[derive(Debug, Default)]
struct State {
    taken: u64,
    most: u64,
    idle: Vec<Vec<u8>>,
}

/// Bytes of the pool; they go back when this is dropped.
#[derive(Debug)]
pub(crate) struct Buffer {
    bytes: Vec<u8>,
    length: usize,
    shared: Arc<Shared>,
}

impl Pool {
    /// A pool of at most `cap` bytes, and a channel that tells when a buffer has come back.
    pub(crate) fn new(cap: u64) -> (Self, crossbeam_channel::Receiver<()>) {
        let (returned, told) = crossbeam_channel::bounded(1);
        let shared = Arc::new(Shared { cap, state: Mutex::default(), returned });
        (Self { shared }, told)
    }

    /// A buffer of `length` bytes with any contents; none while that would exceed the cap.
    pub(crate) fn take(&self, length: usize) -> Option<Buffer> {
        let mut state = self.shared.state();
        let fits =
            |idle: &Vec<u8>| (length..=length.saturating_mul(LEAST_SHARE)).contains(&idle.len());
        let found = (0..state.idle.len())
            .filter(|&at| fits(&state.idle[at]))
            .min_by_key(|&at| state.idle[at].len());
        if let Some(at) = found {
            let bytes = state.idle.swap_remove(at);
            return Some(Buffer { bytes, length, shared: Arc::clone(&self.shared) });
        }
        while state.taken + length as u64 > self.shared.cap {
            let idle = state.idle.pop()?;
            state.taken -= idle.len() as u64;
        }
        state.taken += length as u64;
        state.most = state.most.max(state.taken);
        let bytes = vec![0; length];
        Some(Buffer { bytes, length, shared: Arc::clone(&self.shared) })
    }

    /// Most bytes it ever took.
    pub(crate) fn most(&self) -> u64 {
        self.shared.state().most
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        // Nothing panics while it holds the lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Deref for Buffer {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [u8] {
        &mut self.bytes[..self.length]
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        self.shared.state().idle.push(std::mem::take(&mut self.bytes));
        // A note that is there already will do.
        let _ = self.shared.returned.try_send(());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_exceeds_the_cap_is_not_to_be_had() {
        let (pool, told) = Pool::new(100);
        assert!(pool.take(101).is_none());
        let first = pool.take(60).unwrap();
        assert!(pool.take(41).is_none());
        let second = pool.take(40).unwrap();
        assert_eq!((first.len(), second.len(), pool.most()), (60, 40, 100));
        assert!(told.try_recv().is_err());
        drop(first);
        assert!(told.try_recv().is_ok());
        // Used again, though larger.
        assert_eq!(pool.take(50).unwrap().len(), 50);
        // Too large by far: freed, and one of the right size made.
        assert_eq!(pool.take(5).unwrap().len(), 5);
        assert_eq!(pool.most(), 100);
    }

    #[test]
    fn any_use_stays_within_the_cap() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(2);
        let (pool, _told) = Pool::new(1000);
        let mut held: Vec<Buffer> = Vec::new();
        let (mut refused, mut given) = (0, 0);
        for _ in 0..5000 {
            if rng.random_bool(0.4) && !held.is_empty() {
                held.swap_remove(rng.random_range(0..held.len()));
            } else {
                match pool.take(rng.random_range(0..400)) {
                    Some(buffer) => {
                        held.push(buffer);
                        given += 1;
                    }
                    None => refused += 1,
                }
            }
            assert!(held.iter().map(|buffer| buffer.bytes.len()).sum::<usize>() <= 1000);
            assert!(pool.shared.state().taken <= 1000);
        }
        assert!(refused > 100 && given > 1000, "{refused} {given}");
    }
}
