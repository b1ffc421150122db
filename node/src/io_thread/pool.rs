//! Buffers for bytes on their way from the file to the backend, under a hard cap.

use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A buffer goes to a request no smaller than this share of it, or is freed.
const LEAST_SHARE: usize = 4;

/// Hands out buffers. Those handed out and those waiting for use again take at most the cap; those for what
/// is read ahead leave a reserve, so that what is waited for never waits for them.
#[derive(Debug, Clone)]
pub(crate) struct Pool {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    cap: u64,
    reserve: u64,
    state: Mutex<State>,
    /// Told, without waiting, that a buffer has come back.
    returned: crossbeam_channel::Sender<()>,
}

#[derive(Debug, Default)]
struct State {
    taken: u64,
    /// Handed out for what is read ahead.
    ahead: u64,
    most: u64,
    idle: Vec<Vec<u8>>,
}

/// Bytes of the pool; they go back when this is dropped.
#[derive(Debug)]
pub(crate) struct Buffer {
    bytes: Vec<u8>,
    length: usize,
    ahead: bool,
    shared: Arc<Shared>,
}

impl Pool {
    /// A pool of at most `cap` bytes, all but `reserve` of them for what is read ahead, and a channel that tells when a buffer has come back.
    pub(crate) fn new(cap: u64, reserve: u64) -> (Self, crossbeam_channel::Receiver<()>) {
        let (returned, told) = crossbeam_channel::bounded(1);
        let shared = Arc::new(Shared { cap, reserve, state: Mutex::default(), returned });
        (Self { shared }, told)
    }

    /// A buffer of `length` bytes with any contents; none while that would exceed the cap, or `ahead` what
    /// the reserve leaves of it.
    pub(crate) fn take(&self, length: usize, ahead: bool) -> Option<Buffer> {
        let mut state = self.shared.state();
        let ahead_left = self.shared.cap.saturating_sub(self.shared.reserve + state.ahead);
        let most = if ahead { ahead_left as usize } else { usize::MAX };
        if length > most {
            return None;
        }
        let longest = length.saturating_mul(LEAST_SHARE).min(most);
        let fits = |idle: &Vec<u8>| (length..=longest).contains(&idle.len());
        let found = (0..state.idle.len())
            .filter(|&at| fits(&state.idle[at]))
            .min_by_key(|&at| state.idle[at].len());
        if let Some(at) = found {
            let bytes = state.idle.swap_remove(at);
            state.ahead += if ahead { bytes.len() as u64 } else { 0 };
            return Some(Buffer { bytes, length, ahead, shared: Arc::clone(&self.shared) });
        }
        while state.taken + length as u64 > self.shared.cap {
            let idle = state.idle.pop()?;
            state.taken -= idle.len() as u64;
        }
        state.taken += length as u64;
        state.most = state.most.max(state.taken);
        state.ahead += if ahead { length as u64 } else { 0 };
        let bytes = vec![0; length];
        Some(Buffer { bytes, length, ahead, shared: Arc::clone(&self.shared) })
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
        let mut state = self.shared.state();
        let bytes = std::mem::take(&mut self.bytes);
        state.ahead -= if self.ahead { bytes.len() as u64 } else { 0 };
        state.idle.push(bytes);
        drop(state);
        // A note that is there already will do.
        let _ = self.shared.returned.try_send(());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_exceeds_the_cap_is_not_to_be_had() {
        let (pool, told) = Pool::new(100, 0);
        assert!(pool.take(101, false).is_none());
        let first = pool.take(60, false).unwrap();
        assert!(pool.take(41, false).is_none());
        let second = pool.take(40, false).unwrap();
        assert_eq!((first.len(), second.len(), pool.most()), (60, 40, 100));
        assert!(told.try_recv().is_err());
        drop(first);
        assert!(told.try_recv().is_ok());
        // Used again, though larger.
        assert_eq!(pool.take(50, false).unwrap().len(), 50);
        // Too large by far: freed, and one of the right size made.
        assert_eq!(pool.take(5, false).unwrap().len(), 5);
        assert_eq!(pool.most(), 100);
    }

    #[test]
    fn any_use_stays_within_the_cap() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        let mut rng = StdRng::seed_from_u64(2);
        let (pool, _told) = Pool::new(1000, 250);
        let mut held: Vec<Buffer> = Vec::new();
        let (mut refused, mut given) = (0, 0);
        for _ in 0..5000 {
            if rng.random_bool(0.4) && !held.is_empty() {
                held.swap_remove(rng.random_range(0..held.len()));
            } else {
                match pool.take(rng.random_range(0..250), rng.random()) {
                    Some(buffer) => {
                        held.push(buffer);
                        given += 1;
                    }
                    None => refused += 1,
                }
            }
            assert!(held.iter().map(|buffer| buffer.bytes.len()).sum::<usize>() <= 1000);
            assert!(pool.shared.state().taken <= 1000);
            let ahead = held.iter().filter(|buffer| buffer.ahead).map(|buffer| buffer.bytes.len());
            let ahead = ahead.sum::<usize>();
            assert_eq!(pool.shared.state().ahead, ahead as u64);
            assert!(ahead <= 750, "{ahead}: no room for what is waited for");
        }
        assert!(refused > 100 && given > 1000, "{refused} {given}");
    }
}
