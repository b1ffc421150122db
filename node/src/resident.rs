//! What the backend holds of meshes and textures, and how it comes there: takes in what the I/O thread
//! reads, gives up what is least needed, and draws lists of which not all is there, part by part.

use crate::budget::Budget;
use crate::come::Come;
use crate::io_thread::{Arrival, BESIDES_BYTES, IoThread, Order, Room};
use crate::role::RoleError;
use crate::stream::Runs;
use crossbeam_channel::{Receiver, TryRecvError, select};
use protocol::camera::Camera;
use protocol::format::Skeleton;
use protocol::id::{BlobId, FrameIndex};
use protocol::settings::Residency as Promise;
use protocol::telemetry::IoCounts;
use protocol::visible::VisibleSet;
use scene::asset::{Asset, needs};
use scene::backend::Draws;
use scene::backend::{Backend, Part, Upload};
use scene::front::FrontEntry;
use scene::prefetch::{LOOKED_AHEAD, Outlook};
use scene::residency::{Residency, Stamp, Use};
use scene::trajectory::Trajectory;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Meshes and textures of one backend.
pub(crate) struct Loader {
    skeleton: Arc<Skeleton>,
    io: IoThread,
    /// Read and not with the backend yet.
    come: Come,
    residency: Residency,
    budget: Budget,
    prefetch: bool,
    /// The present drawing.
    now: Stamp,
    /// The drawing that ordered last.
    ordered: Option<Stamp>,
    /// Blobs and textures that cannot be read, by [`Asset::index`].
    lost: Vec<bool>,
    /// Pictures are drawn here: forecasts name textures.
    textures: bool,
    /// The last outlook given.
    outlook: Option<Outlook>,
    trajectory: Trajectory,
    /// The camera drawn last.
    drawn: Option<Camera>,
    /// Frames to be drawn here, as far ahead as is looked.
    ahead: Vec<FrameIndex>,
    /// What was visible last, as far as is known here.
    visible: Arc<VisibleSet>,
    /// Bytes this drawing may still take in of what nobody waits for.
    besides_left: u64,
    peak: Arc<AtomicU64>,
    counts: IoCounts,
}

/// How a list was drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Drawn {
    /// All of it.
    Whole,
    /// Something turned out to be unreadable: the pass was ended early, and what is drawn must be chosen anew.
    Lost,
}

/// What a drawing needs of the meshes it draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Needs {
    /// Their shape: no texture decides whether an opaque triangle hides something.
    Shape,
    /// What they look like, too: their textures.
    Look,
}

impl Loader {
    /// Nothing is held. `peak` follows the most bytes held, skeleton and buffers included.
    pub(crate) fn new(
        skeleton: Arc<Skeleton>,
        io: IoThread,
        budget: Budget,
        prefetch: bool,
        peak: Arc<AtomicU64>,
    ) -> Self {
        let (blobs, textures) = (skeleton.blobs.len(), skeleton.textures.len());
        Self {
            skeleton,
            io,
            come: Come::default(),
            residency: Residency::new(blobs, textures),
            budget,
            prefetch,
            now: 0,
            ordered: None,
            lost: vec![false; blobs + textures],
            textures: false,
            outlook: None,
            trajectory: Trajectory::default(),
            drawn: None,
            ahead: Vec::new(),
            visible: Arc::new(VisibleSet::from_sorted(Vec::new())),
            besides_left: BESIDES_BYTES,
            peak,
            counts: IoCounts::default(),
        }
    }

    /// Which blobs are held, and when each was used last.
    #[cfg(test)]
    pub(crate) fn residency(&self) -> &Residency {
        &self.residency
    }

    /// What was counted since the last call: a drawing, and what was taken in while the seat waited for it.
    /// The next has a share of its own of what nobody waits for.
    pub(crate) fn take_counts(&mut self) -> IoCounts {
        self.besides_left = BESIDES_BYTES;
        std::mem::take(&mut self.counts)
    }

    /// Begins another drawing, which first takes in its share of what has come meanwhile: what it uses is
    /// younger than all before.
    pub(crate) fn begin_drawing(&mut self, backend: &mut dyn Backend) -> Result<(), RoleError> {
        self.now += 1;
        self.note_peak(backend);
        self.stalled(|own| {
            while own.take_in_next(backend)? {}
            Ok(())
        })
    }

    /// Counts the time that `work` takes as waiting.
    fn stalled<T>(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<T, RoleError>,
    ) -> Result<T, RoleError> {
        let waiting = Instant::now();
        let done = work(self);
        self.counts.stall_ns += waiting.elapsed().as_nanos() as u64;
        done
    }

    fn note_peak(&self, backend: &dyn Backend) {
        let held = self.budget.skeleton + backend.held_bytes() + self.io.pool.most();
        self.peak.fetch_max(held, Ordering::Relaxed);
    }

    fn is_lost(&self, asset: Asset) -> bool {
        self.lost[asset.index(self.skeleton.blobs.len())]
    }

    fn is_missing(&self, asset: Asset) -> bool {
        !self.residency.holds(asset) && !self.is_lost(asset)
    }

    /// Whether a blob can be drawn: in `exact` if all it needs can be had, in `deadline` if it is there.
    pub(crate) fn offers(&self, blob: BlobId, promise: Promise, what: Needs) -> bool {
        needs(&self.skeleton, blob, what == Needs::Look).all(|asset| match promise {
            Promise::Exact => !self.is_lost(asset),
            Promise::Deadline => self.residency.holds(asset),
        })
    }

    /// Whether all of a level can be drawn.
    pub(crate) fn offers_level(&self, level: u32, promise: Promise, what: Needs) -> bool {
        self.skeleton.blobs_of(level).all(|blob| self.offers(blob, promise, what))
    }

    /// Loads what is to stay for good.
    pub(crate) fn load_for_good(
        &mut self,
        backend: &mut dyn Backend,
        entries: &[FrontEntry],
    ) -> Result<(), RoleError> {
        let blobs = entries.iter().flat_map(|entry| self.skeleton.blobs_of(entry.level));
        let mut assets: Vec<Asset> =
            blobs.flat_map(|blob| needs(&self.skeleton, blob, true)).collect();
        assets.sort_unstable();
        assets.dedup();
        self.fetch(assets.clone());
        while assets.iter().any(|&asset| self.is_missing(asset)) {
            let arrival = self.io.wait().ok_or(RoleError::IoThread)?;
            if let Some(arrival) = self.readable(arrival) {
                self.take_in(backend, arrival)?;
            }
        }
        for asset in assets {
            if self.residency.holds(asset) {
                self.residency.touch(asset, Stamp::MAX);
            }
        }
        Ok(())
    }

    /// Orders what `blobs` need and is not there, and does not wait for it but for the thread to hear it.
    pub(crate) fn order_missing(&mut self, blobs: impl IntoIterator<Item = BlobId>, what: Needs) {
        let (skeleton, with_textures) = (Arc::clone(&self.skeleton), what == Needs::Look);
        let all = blobs.into_iter().flat_map(|blob| needs(&skeleton, blob, with_textures));
        let mut assets: Vec<Asset> = all.filter(|&asset| self.is_missing(asset)).collect();
        assets.sort_unstable();
        assets.dedup();
        if !assets.is_empty() {
            self.counts.misses += assets.len() as u64;
            let waiting = Instant::now();
            self.fetch(assets);
            self.counts.stall_ns += waiting.elapsed().as_nanos() as u64;
        }
    }

    /// Gives a fetch command; the first of a drawing takes the place of what the last one ordered.
    fn fetch(&mut self, assets: Vec<Asset>) {
        let replaces = self.ordered.replace(self.now) != Some(self.now);
        self.io.fetch(assets, replaces);
    }

    /// Draws a list in its order, in one part where all it needs is there; else it draws what comes before
    /// the first that is missing, waits, and goes on. So the picture is that of one part.
    pub(crate) fn stream(
        &mut self,
        backend: &mut dyn Backend,
        draws: &Draws,
        what: Needs,
        mut submit: impl FnMut(&mut dyn Backend, Draws, Part) -> Result<(), RoleError>,
    ) -> Result<Drawn, RoleError> {
        let (skeleton, with_textures) = (Arc::clone(&self.skeleton), what == Needs::Look);
        self.textures |= with_textures;
        let mut runs = Runs::new(draws, |blob| needs(&skeleton, blob, with_textures));
        self.count_needs(&runs);
        let (mut opens, mut is_fresh) = (true, false);
        loop {
            let ready = runs.ready(|asset| self.residency.holds(asset));
            let closes = ready.end == runs.len();
            if closes || !ready.is_empty() {
                if std::mem::take(&mut is_fresh) {
                    self.stalled(|_| Ok(backend.settle()?))?;
                }
                submit(backend, runs.draws(ready.clone()), Part { opens, closes })?;
                opens = false;
                runs.advance(ready.end);
            }
            if closes {
                return Ok(Drawn::Whole);
            }
            if runs.next_needs().iter().any(|&asset| self.is_lost(asset)) {
                submit(backend, Draws::default(), Part { opens, closes: true })?;
                return Ok(Drawn::Lost);
            }
            self.stalled(|own| own.load_next(backend, &mut runs))?;
            is_fresh = true;
        }
    }

    /// Counts hits, misses and events, and marks what is there as used.
    fn count_needs(&mut self, runs: &Runs<'_>) {
        for asset in runs.assets() {
            if !self.residency.holds(asset) {
                self.counts.misses += 1;
                self.counts.events += 1;
                continue;
            }
            let Use { before, foreseen } = self.residency.touch(asset, self.now);
            if before == self.now {
                continue;
            }
            let is_event = foreseen || before.saturating_add(1) < self.now;
            self.counts.hits += 1;
            self.counts.events += u64::from(is_event);
            self.counts.events_foreseen += u64::from(is_event);
            if foreseen {
                self.counts.prefetched_used += asset.file_bytes(&self.skeleton);
            }
        }
    }

    /// Orders as much of what is missing as buffers hold, waits for one of it, and takes in all of it that
    /// has come: no more than that, whatever else has come with it.
    fn load_next(
        &mut self,
        backend: &mut dyn Backend,
        runs: &mut Runs<'_>,
    ) -> Result<(), RoleError> {
        let bytes = |asset: Asset| asset.file_bytes(&self.skeleton);
        let mut orders =
            runs.next_orders(self.budget.host, bytes, |asset| self.residency.holds(asset));
        let here: Vec<Asset> = orders.extract_if(.., |asset| self.come.has(*asset)).collect();
        if !orders.is_empty() {
            self.fetch(orders);
        }
        let was_here = !here.is_empty();
        for arrival in
            here.into_iter().filter_map(|asset| self.come.take(asset)).collect::<Vec<_>>()
        {
            self.take_in_for(backend, arrival, runs)?;
        }

        if !self.take_what_came(backend, runs)? && !was_here {
            // What nobody waits for any more leaves its buffers to what is waited for.
            for asset in self.come.drop_fetched() {
                self.io.claims.clear(asset);
            }
            self.counts.waits += 1;
            let arrival = self.io.wait().ok_or(RoleError::IoThread)?;
            self.take_or_keep(backend, arrival, runs)?;
            self.take_what_came(backend, runs)?;
        }
        Ok(())
    }

    /// Takes in all that a list waits for of what has come; whether anything.
    fn take_what_came(
        &mut self,
        backend: &mut dyn Backend,
        runs: &mut Runs<'_>,
    ) -> Result<bool, RoleError> {
        let mut any = false;
        while runs.lacks(|asset| self.residency.holds(asset)) {
            let Ok(arrival) = self.io.arrivals.try_recv() else { break };
            any |= self.take_or_keep(backend, arrival, runs)?;
        }
        Ok(any)
    }

    /// Takes in an arrival that a list waits for; another is kept for later. Whether it was waited for.
    fn take_or_keep(
        &mut self,
        backend: &mut dyn Backend,
        arrival: Arrival,
        runs: &mut Runs<'_>,
    ) -> Result<bool, RoleError> {
        let is_wanted = runs.arrived(arrival.asset);
        match self.readable(arrival) {
            Some(arrival) if is_wanted => self.take_in_for(backend, arrival, runs)?,
            Some(arrival) => self.come.keep(arrival),
            None => {}
        }
        Ok(is_wanted)
    }

    /// Takes in what a list waits for, at the cost of what the list has drawn or draws last.
    fn take_in_for(
        &mut self,
        backend: &mut dyn Backend,
        arrival: Arrival,
        runs: &mut Runs<'_>,
    ) -> Result<(), RoleError> {
        let asset = arrival.asset;
        runs.arrived(asset);
        let is_next = runs.next_needs().contains(&asset);
        if runs.needs_order() && !is_next {
            return self.put_off(asset, runs);
        }
        while !self.upload(backend, &arrival, false)? {
            let own = |other: &Asset| other.is_texture() == asset.is_texture();
            let older = self.residency.older_than(self.now).find(own);
            let older = self.spare(asset).or(older);
            match older.or_else(|| runs.victim(asset, |other| self.residency.holds(other))) {
                Some(victim) => self.give_up(backend, victim),
                None if is_next => self.make_whole(backend, asset, runs)?,
                None => return self.put_off(asset, runs),
            }
        }
        Ok(())
    }

    /// Gives back what has come too early: its turn comes later.
    fn put_off(&mut self, asset: Asset, runs: &mut Runs<'_>) -> Result<(), RoleError> {
        runs.forget(asset);
        self.io.claims.clear(asset);
        Ok(())
    }

    /// What is free for a texture lies in pieces, between textures of the same mesh: gives those up, too, and
    /// has them come again one after the other, with nothing between them.
    fn make_whole(
        &mut self,
        backend: &mut dyn Backend,
        asset: Asset,
        runs: &mut Runs<'_>,
    ) -> Result<(), RoleError> {
        let needs = runs.next_needs().iter().copied();
        let beside = needs.filter(|other| other.is_texture() && self.residency.holds(*other));
        let beside: Vec<Asset> =
            beside.filter(|&other| !self.residency.is_for_good(other)).collect();
        if !asset.is_texture() || beside.is_empty() {
            return Err(RoleError::NoRoom);
        }
        for other in beside {
            self.give_up(backend, other);
        }
        runs.bring_in_order();
        Ok(())
    }

    /// The least recently used of the kind of `asset` that the present drawing does not use and no forecast
    /// names.
    fn spare(&self, asset: Asset) -> Option<Asset> {
        let mut older = self.residency.older_than(self.now);
        older.find(|&old| old.is_texture() == asset.is_texture() && !self.io.likely.has(old))
    }

    /// Counts what has come. None of what could not be read, which is said.
    fn readable(&mut self, arrival: Arrival) -> Option<Arrival> {
        match &arrival.bytes {
            Ok(bytes) => {
                self.counts.bytes_read += bytes.len() as u64;
                if arrival.foreseen {
                    self.counts.prefetched += bytes.len() as u64;
                }
                Some(arrival)
            }
            Err(error) => {
                tracing::warn!("{error}; something coarser is shown");
                self.lost[arrival.asset.index(self.skeleton.blobs.len())] = true;
                self.counts.faults += 1;
                None
            }
        }
    }

    /// Whether there was room.
    fn upload(
        &mut self,
        backend: &mut dyn Backend,
        arrival: &Arrival,
        foreseen: bool,
    ) -> Result<bool, RoleError> {
        let bytes = arrival.bytes.as_ref().expect("only what was read is kept");
        let upload = match arrival.asset {
            Asset::Blob(id) => backend.upload(id, self.skeleton.blob(id), bytes)?,
            Asset::Texture(index) => backend.upload_texture(index, bytes)?,
        };
        if upload == Upload::Full {
            return Ok(false);
        }
        // What nobody waits for is no part of the present drawing, which may give it up.
        let used = if foreseen { self.now.saturating_sub(1) } else { self.now };
        self.residency.insert(arrival.asset, used, foreseen);
        self.note_peak(backend);
        Ok(true)
    }

    /// Evicts something that is held.
    pub(crate) fn give_up(&mut self, backend: &mut dyn Backend, asset: Asset) {
        match asset {
            Asset::Blob(id) => backend.evict(id),
            Asset::Texture(index) => backend.evict_texture(index),
        }
        self.residency.remove(asset);
        self.io.claims.clear(asset);
        self.counts.evicted += asset.stored_bytes(&self.skeleton);
    }

    /// Moves all that has come to this side of the channel.
    fn look_at_arrivals(&mut self) {
        while let Ok(arrival) = self.io.arrivals.try_recv() {
            if let Some(arrival) = self.readable(arrival) {
                self.come.keep(arrival);
            }
        }
    }

    /// Takes in the next of what has come that no list waits for, where this drawing's share has room for it
    /// and the backend, or something less likely to be needed gives way. Whether there may be more.
    fn take_in_next(&mut self, backend: &mut dyn Backend) -> Result<bool, RoleError> {
        self.look_at_arrivals();
        let Some(next) = self.come.next() else { return Ok(false) };
        let bytes = next.asset.stored_bytes(&self.skeleton);
        // Something large that was fetched comes alone: it is what some drawing lacked.
        let comes_alone = !next.foreseen && self.besides_left == BESIDES_BYTES;
        if bytes > self.besides_left && !comes_alone {
            return Ok(false);
        }
        let arrival = self.come.take_next().expect("it was there");
        self.besides_left = self.besides_left.saturating_sub(bytes);
        self.counts.besides += if arrival.foreseen { bytes } else { 0 };
        self.take_in(backend, arrival)?;
        Ok(true)
    }

    /// Takes in what nothing waits for, where there is room or something less likely to be needed.
    fn take_in(&mut self, backend: &mut dyn Backend, arrival: Arrival) -> Result<(), RoleError> {
        while !self.upload(backend, &arrival, arrival.foreseen)? {
            let Some(victim) = self.spare(arrival.asset) else {
                self.io.claims.clear(arrival.asset);
                return Ok(());
            };
            self.give_up(backend, victim);
        }
        Ok(())
    }

    /// Waits for a job, and takes in what comes meanwhile, within this drawing's share. None once there are
    /// no more jobs. A job that had to wait for that counts the time.
    pub(crate) fn take_in_until<J>(
        &mut self,
        backend: &mut dyn Backend,
        jobs: &Receiver<J>,
    ) -> Result<Option<J>, RoleError> {
        loop {
            match jobs.try_recv() {
                Ok(job) => return Ok(Some(job)),
                Err(TryRecvError::Disconnected) => return Ok(None),
                Err(TryRecvError::Empty) => {}
            }
            let started = Instant::now();
            if self.take_in_next(backend)? {
                let waited = if jobs.is_empty() { 0 } else { started.elapsed().as_nanos() };
                self.counts.stall_ns += waited as u64;
                continue;
            }
            if self.come.next().is_some() {
                // This drawing's share is used up.
                return Ok(jobs.recv().ok());
            }
            select! {
                recv(jobs) -> job => return Ok(job.ok()),
                recv(self.io.arrivals) -> arrival => {
                    let arrival = arrival.map_err(|_| RoleError::IoThread)?;
                    let read = self.readable(arrival);
                    self.come.extend(read);
                }
            }
        }
    }

    /// Learns the camera of a frame and which frames are to be drawn here next, and has read ahead what
    /// that lets expect: at first the front of the first camera, before anybody knows what of it is
    /// visible. A node that never draws never loads.
    pub(crate) fn look_ahead(
        &mut self,
        newest: Option<(FrameIndex, Camera)>,
        ahead: Vec<FrameIndex>,
    ) {
        if let Some((frame, camera)) = newest {
            self.trajectory.note(frame, camera);
        }
        self.ahead = ahead;
        self.foresee();
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

    fn foresee(&mut self) {
        // Before anything is known to be visible a forecast would name all that the frustum holds.
        if !self.prefetch || self.drawn.is_none() && self.visible.is_empty() {
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
        let in_use: Vec<Asset> = self.residency.used_since(self.now).collect();
        let mut room = Room {
            blobs: self.budget.device - self.budget.textures,
            textures: self.budget.textures,
        };
        for asset in &in_use {
            let of_kind = if asset.is_texture() { &mut room.textures } else { &mut room.blobs };
            *of_kind = of_kind.saturating_sub(asset.stored_bytes(&self.skeleton));
        }
        let textures = self.textures;
        self.io.foresee(Order::Foresee { outlook: outlook.clone(), in_use, room, textures });
        self.outlook = Some(outlook);
    }
}

/// What comes next is the same in both.
fn says_as_much(last: &Outlook, new: &Outlook) -> bool {
    Arc::ptr_eq(&last.visible, &new.visible) && last.ahead[0] == new.ahead[0]
}

#[cfg(test)]
mod tests;
