//! Which geometry the backend holds, and how it comes there: takes in what the I/O thread reads, gives
//! up what is least needed, and draws lists whose geometry is there only in part, part by part.

use crate::budget::Budget;
use crate::io_thread::{Arrival, IoThread, Order};
use crate::role::RoleError;
use crate::stream::Runs;
use crossbeam_channel::{Receiver, TryRecvError, select};
use protocol::camera::Camera;
use protocol::format::Skeleton;
use protocol::id::{BlobId, FrameIndex};
use protocol::settings::Residency as Promise;
use protocol::telemetry::IoCounts;
use protocol::visible::VisibleSet;
use scene::backend::Draws;
use scene::backend::{Backend, Part, Upload};
use scene::front::FrontEntry;
use scene::prefetch::{LOOKED_AHEAD, Outlook};
use scene::residency::{Residency, Stamp, Use};
use scene::trajectory::Trajectory;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Bytes a frame takes in of what nobody waits for.
const UPLOAD_BYTES: u64 = 16 << 20;

/// Geometry of one backend.
pub(crate) struct Loader {
    skeleton: Arc<Skeleton>,
    io: IoThread,
    residency: Residency,
    budget: Budget,
    /// All that may be drawn, until it is ordered as a whole.
    drawable: Vec<BlobId>,
    prefetch: bool,
    /// The present drawing.
    now: Stamp,
    /// Blobs that cannot be read.
    lost: Vec<bool>,
    /// The last outlook given.
    outlook: Option<Outlook>,
    trajectory: Trajectory,
    /// The camera drawn last.
    drawn: Option<Camera>,
    /// Frames to be drawn here, as far ahead as is looked.
    ahead: Vec<FrameIndex>,
    /// What was visible last, as far as is known here.
    visible: Arc<VisibleSet>,
    /// Bytes this frame may still take in of what nobody waits for.
    upload_left: u64,
    peak: Arc<AtomicU64>,
    counts: IoCounts,
}

/// How a list was drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Drawn {
    /// All of it.
    Whole,
    /// A blob turned out to be unreadable: the pass was ended early, and what is drawn must be chosen anew.
    Lost,
}

impl Loader {
    /// Nothing is held of `drawable`, which is all that may be drawn. `peak` follows the most bytes held, buffers included.
    pub(crate) fn new(
        skeleton: Arc<Skeleton>,
        io: IoThread,
        budget: Budget,
        drawable: Vec<BlobId>,
        prefetch: bool,
        peak: Arc<AtomicU64>,
    ) -> Self {
        let blobs = skeleton.blobs.len();
        Self {
            skeleton,
            io,
            residency: Residency::new(blobs),
            budget,
            drawable,
            prefetch,
            now: 0,
            lost: vec![false; blobs],
            outlook: None,
            trajectory: Trajectory::default(),
            drawn: None,
            ahead: Vec::new(),
            visible: Arc::new(VisibleSet::from_sorted(Vec::new())),
            upload_left: UPLOAD_BYTES,
            peak,
            counts: IoCounts::default(),
        }
    }

    /// Which blobs are held, and when each was used last.
    #[cfg(test)]
    pub(crate) fn residency(&self) -> &Residency {
        &self.residency
    }

    /// What was counted since the last call.
    pub(crate) fn take_counts(&mut self) -> IoCounts {
        std::mem::take(&mut self.counts)
    }

    /// Begins another drawing: what it uses is younger than all before.
    pub(crate) fn begin_drawing(&mut self, backend: &dyn Backend) {
        self.now += 1;
        self.upload_left = UPLOAD_BYTES;
        self.note_peak(backend);
    }

    fn note_peak(&self, backend: &dyn Backend) {
        self.peak.fetch_max(backend.held_bytes() + self.io.pool.most(), Ordering::Relaxed);
    }

    /// Whether a blob can be drawn: in `exact` if it can be had, in `deadline` if it is there.
    pub(crate) fn offers(&self, blob: BlobId, promise: Promise) -> bool {
        match promise {
            Promise::Exact => !self.lost[blob.index()],
            Promise::Deadline => self.residency.holds(blob),
        }
    }

    /// Whether all of a level can be drawn.
    pub(crate) fn offers_level(&self, level: u32, promise: Promise) -> bool {
        self.skeleton.blobs_of(level).all(|blob| self.offers(blob, promise))
    }

    /// Loads what is to stay for good.
    pub(crate) fn load_for_good(
        &mut self,
        backend: &mut dyn Backend,
        entries: &[FrontEntry],
    ) -> Result<(), RoleError> {
        let blobs = self.blobs_of(entries);
        self.io.fetch(blobs.clone());
        let is_missing =
            |own: &Self, blob: &BlobId| !own.residency.holds(*blob) && !own.lost[blob.index()];
        while blobs.iter().any(|blob| is_missing(self, blob)) {
            let arrival = self.io.wait().ok_or(RoleError::IoThread)?;
            self.take_in(backend, arrival)?;
        }
        for blob in blobs {
            if self.residency.holds(blob) {
                self.residency.touch(blob, Stamp::MAX);
            }
        }
        Ok(())
    }

    fn blobs_of(&self, entries: &[FrontEntry]) -> Vec<BlobId> {
        let of_entry = |entry: &FrontEntry| self.skeleton.blobs_of(entry.level);
        let mut blobs: Vec<BlobId> = entries.iter().flat_map(of_entry).collect();
        blobs.sort_unstable();
        blobs.dedup();
        blobs
    }

    /// Orders those of `blobs` that are not there, and does not wait for them.
    pub(crate) fn order_missing(&mut self, blobs: impl IntoIterator<Item = BlobId>) {
        let is_missing = |blob: &BlobId| !self.residency.holds(*blob) && !self.lost[blob.index()];
        let mut blobs: Vec<BlobId> = blobs.into_iter().filter(is_missing).collect();
        blobs.sort_unstable();
        blobs.dedup();
        if !blobs.is_empty() {
            self.counts.misses += blobs.len() as u64;
            self.io.fetch(blobs);
        }
    }

    /// Draws a list in its order, in one part where all its geometry is there; else it draws what comes
    /// before the first blob that is missing, waits, and goes on. So the picture is that of one part.
    pub(crate) fn stream(
        &mut self,
        backend: &mut dyn Backend,
        draws: &Draws,
        mut submit: impl FnMut(&mut dyn Backend, Draws, Part) -> Result<(), RoleError>,
    ) -> Result<Drawn, RoleError> {
        let mut runs = Runs::new(draws);
        self.count_needs(&runs);
        let mut opens = true;
        loop {
            let ready = runs.ready(|blob| self.residency.holds(blob));
            let closes = ready.end == runs.len();
            if closes || !ready.is_empty() {
                submit(backend, runs.draws(ready.clone()), Part { opens, closes })?;
                opens = false;
                runs.advance(ready.end);
            }
            if closes {
                return Ok(Drawn::Whole);
            }
            if runs.next_blob().is_some_and(|blob| self.lost[blob.index()]) {
                submit(backend, Draws::default(), Part { opens, closes: true })?;
                return Ok(Drawn::Lost);
            }
            let waiting = Instant::now();
            let arrival = self.next_arrival(&mut runs)?;
            self.counts.stall_ns += waiting.elapsed().as_nanos() as u64;
            self.take_in_for(backend, arrival, &mut runs)?;
            while let Ok(arrival) = self.io.arrivals.try_recv() {
                self.take_in_for(backend, arrival, &mut runs)?;
            }
        }
    }

    /// Counts hits, misses and events, and marks what is there as used.
    fn count_needs(&mut self, runs: &Runs<'_>) {
        for blob in runs.blobs() {
            if !self.residency.holds(blob) {
                self.counts.misses += 1;
                self.counts.events += 1;
                continue;
            }
            let Use { before, foreseen } = self.residency.touch(blob, self.now);
            if before == self.now {
                continue;
            }
            let is_event = foreseen || before.saturating_add(1) < self.now;
            self.counts.hits += 1;
            self.counts.events += u64::from(is_event);
            self.counts.events_foreseen += u64::from(is_event);
            if foreseen {
                self.counts.prefetched_used += self.skeleton.blob(blob).bytes;
            }
        }
    }

    /// Orders as much of what is missing as buffers hold, and waits for what comes first.
    fn next_arrival(&mut self, runs: &mut Runs<'_>) -> Result<Arrival, RoleError> {
        let bytes = |blob: BlobId| self.skeleton.blob(blob).bytes;
        let orders = runs.next_orders(self.budget.host, bytes, |blob| self.residency.holds(blob));
        if !orders.is_empty() {
            self.io.fetch(orders);
        }
        self.io.wait().ok_or(RoleError::IoThread)
    }

    /// Takes in what a list waits for, at the cost of what the list has drawn or draws last.
    fn take_in_for(
        &mut self,
        backend: &mut dyn Backend,
        arrival: Arrival,
        runs: &mut Runs<'_>,
    ) -> Result<(), RoleError> {
        let blob = arrival.blob;
        let is_wanted = runs.arrived(blob);
        if !is_wanted {
            return self.take_in(backend, arrival);
        }
        let Some(bytes) = self.readable(&arrival) else { return Ok(()) };
        while !self.upload(backend, blob, bytes, false)? {
            let older = self.spare().or_else(|| self.residency.older_than(self.now).next());
            match older.or_else(|| runs.victim(blob, |blob| self.residency.holds(blob))) {
                Some(victim) => self.give_up(backend, victim),
                None if runs.next_blob() == Some(blob) => return Err(RoleError::NoRoom),
                None => {
                    // Its turn comes later.
                    runs.forget(blob);
                    self.io.claims.clear(blob);
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    /// Takes in what nothing waits for, where there is room or something less likely to be needed.
    fn take_in(&mut self, backend: &mut dyn Backend, arrival: Arrival) -> Result<(), RoleError> {
        let blob = arrival.blob;
        let Some(bytes) = self.readable(&arrival) else { return Ok(()) };
        self.upload_left = self.upload_left.saturating_sub(bytes.len() as u64);
        while !self.upload(backend, blob, bytes, arrival.foreseen)? {
            let Some(victim) = self.spare() else {
                self.io.claims.clear(blob);
                return Ok(());
            };
            self.give_up(backend, victim);
        }
        Ok(())
    }

    /// The least recently used blob that the present drawing does not use and no forecast names.
    fn spare(&self) -> Option<BlobId> {
        self.residency.older_than(self.now).find(|&blob| !self.io.likely.has(blob))
    }

    /// The bytes of an arrival, which are counted; none of one that could not be read, which is said.
    fn readable<'b>(&mut self, arrival: &'b Arrival) -> Option<&'b [u8]> {
        match &arrival.bytes {
            Ok(bytes) => {
                self.counts.bytes_read += bytes.len() as u64;
                if arrival.foreseen {
                    self.counts.prefetched += bytes.len() as u64;
                }
                Some(bytes)
            }
            Err(error) => {
                tracing::warn!("{error}; something coarser is shown");
                self.lost[arrival.blob.index()] = true;
                self.counts.faults += 1;
                None
            }
        }
    }

    /// Whether there was room.
    fn upload(
        &mut self,
        backend: &mut dyn Backend,
        blob: BlobId,
        bytes: &[u8],
        foreseen: bool,
    ) -> Result<bool, RoleError> {
        if backend.upload(blob, self.skeleton.blob(blob), bytes)? == Upload::Full {
            return Ok(false);
        }
        self.residency.insert(blob, self.now, foreseen);
        self.note_peak(backend);
        Ok(true)
    }

    fn give_up(&mut self, backend: &mut dyn Backend, blob: BlobId) {
        backend.evict(blob);
        self.residency.remove(blob);
        self.io.claims.clear(blob);
        self.counts.evicted += self.skeleton.blob(blob).bytes;
    }

    /// Takes in what has come meanwhile, within this frame's share.
    pub(crate) fn take_in_all(&mut self, backend: &mut dyn Backend) -> Result<(), RoleError> {
        while self.upload_left > 0 {
            let Ok(arrival) = self.io.arrivals.try_recv() else { break };
            self.take_in(backend, arrival)?;
        }
        Ok(())
    }

    /// Waits for a job, and takes in what comes meanwhile, within this frame's share. None once there
    /// are no more jobs.
    pub(crate) fn take_in_until<J>(
        &mut self,
        backend: &mut dyn Backend,
        jobs: &Receiver<J>,
    ) -> Result<Option<J>, RoleError> {
        loop {
            match jobs.try_recv() {
                Ok(job) => return Ok(Some(job)),
                Err(TryRecvError::Disconnected) => return Ok(None),
                Err(TryRecvError::Empty) if self.upload_left == 0 => return Ok(jobs.recv().ok()),
                Err(TryRecvError::Empty) => {}
            }
            select! {
                recv(jobs) -> job => return Ok(job.ok()),
                recv(self.io.arrivals) -> arrival => {
                    let arrival = arrival.map_err(|_| RoleError::IoThread)?;
                    self.take_in(backend, arrival)?;
                }
            }
        }
    }

    /// Learns the camera of a frame and which frames are to be drawn here next, and has read ahead what
    /// that lets expect: at first the front of the first camera, before anybody knows what of it is
    /// visible, and where the scene fits, all the rest. A node that never draws never loads.
    pub(crate) fn look_ahead(
        &mut self,
        newest: Option<(FrameIndex, Camera)>,
        ahead: Vec<FrameIndex>,
    ) {
        if let Some((frame, camera)) = newest {
            self.trajectory.note(frame, camera);
        }
        self.ahead = ahead;
        let is_first = self.outlook.is_none();
        self.foresee();
        if is_first && self.outlook.is_some() && self.budget.fits {
            self.io.foresee(Order::Everything(std::mem::take(&mut self.drawable)));
        }
    }

    /// Learns what is visible in a frame, which is drawn if that was to be done here, and has read ahead
    /// what that lets expect.
    pub(crate) fn note_visible(&mut self, frame: FrameIndex, visible: &Arc<VisibleSet>) {
        if self.ahead.contains(&frame) {
            self.drawn = self.trajectory.at(frame);
            self.ahead.retain(|&next| next > frame);
        }
        self.visible = Arc::clone(visible);
        self.foresee();
    }

    /// A scene that fits is on its way as a whole from the first outlook on, and no word is lost.
    fn foresee(&mut self) {
        if !self.prefetch || (self.budget.fits && self.outlook.is_some()) {
            return;
        }
        let next = self.ahead.iter().take(LOOKED_AHEAD);
        let ahead: Vec<Camera> = next.filter_map(|&frame| self.trajectory.at(frame)).collect();
        if ahead.is_empty() {
            return;
        }
        let outlook = Outlook { drawn: self.drawn, ahead, visible: Arc::clone(&self.visible) };
        if self.outlook.as_ref().is_some_and(|last| says_as_much(last, &outlook)) {
            return;
        }
        // What the present drawing uses stays; the rest makes room.
        let in_use: Vec<BlobId> = self.residency.used_since(self.now).collect();
        let used = in_use.iter().map(|&blob| self.skeleton.blob(blob).bytes);
        let room = self.budget.device.saturating_sub(used.sum());
        self.io.foresee(Order::Foresee { outlook: outlook.clone(), in_use, room });
        self.outlook = Some(outlook);
    }
}

/// What comes next is the same in both.
fn says_as_much(last: &Outlook, new: &Outlook) -> bool {
    Arc::ptr_eq(&last.visible, &new.visible) && last.ahead[0] == new.ahead[0]
}
