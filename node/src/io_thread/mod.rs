//! The I/O thread (Manocha, section 5.5): reads meshes and textures beside the render loop.
//!
//! In the paper's stages: until a fetch command comes it reads what the last forecast names (stage I);
//! then what the frame lacks, L_O, while the render side draws L_I (stage II); then what the next
//! forecast names (stage III). It alone touches the map of the file.

mod marks;
pub(crate) mod pool;
#[cfg(test)]
mod tests;

use crossbeam_channel::{Receiver, Sender, TryRecvError, bounded, select};
use farfield::field::FarField;
use marks::Marks;
use pool::{Buffer, Pool};
use protocol::format::Skeleton;
use scene::asset::{Asset, needs};
use scene::prefetch::{Forecaster, Outlook};
use scene::store::{Store, StoreError};
use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Orders that may wait: a frame gives two, and waits for one of them.
const ORDERS: usize = 8;
/// Arrivals that may wait to be taken in. Buffers bound their bytes; this many small ones come between two
/// drawings.
const ARRIVALS: usize = 1024;

/// Bytes that a drawing takes in of what it does not wait for; what is larger is not read ahead.
pub(crate) const BESIDES_BYTES: u64 = 16 << 20;

/// Bytes that a forecast has read of what may as well be hidden: most of it is, and its reading takes time from
/// those who draw where cores are few. The next forecast reads on. What begins below it is read whole.
const GUESSED_BYTES: u64 = 1 << 20;

/// Where blobs and textures come from.
pub(crate) trait Source: Send {
    /// Reads and checks one; `out` has its length.
    fn read(&self, asset: Asset, out: &mut [u8]) -> Result<(), StoreError>;
}

impl Source for Arc<Store> {
    fn read(&self, asset: Asset, out: &mut [u8]) -> Result<(), StoreError> {
        match asset {
            Asset::Blob(id) => self.read_blob(id, out),
            Asset::Texture(index) => self.read_texture(index, out),
        }
    }
}

/// What the render side wants.
#[derive(Debug)]
pub(crate) enum Order {
    /// The fetch command: these in this order, before anything else.
    Fetch {
        /// What to read.
        assets: Vec<Asset>,
        /// Another drawing has begun: what the last one ordered and has not been read is not wanted any more.
        replaces: bool,
    },
    /// Read ahead what is likely to be needed next.
    Foresee {
        /// What the forecast is made from.
        outlook: Outlook,
        /// What the present drawing uses.
        in_use: Vec<Asset>,
        /// Bytes beside that.
        room: Room,
        /// With the textures of what is named.
        textures: bool,
    },
}

/// Bytes that a forecast may name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Room {
    /// Of blobs.
    pub(crate) blobs: u64,
    /// Of textures.
    pub(crate) textures: u64,
}

/// Something that was read, or could not be.
#[derive(Debug)]
pub(crate) struct Arrival {
    pub(crate) asset: Asset,
    pub(crate) bytes: Result<Buffer, StoreError>,
    /// Nobody has fetched it.
    pub(crate) foreseen: bool,
}

/// The render side's end.
#[derive(Debug)]
pub(crate) struct IoThread {
    orders: Sender<Order>,
    pub(crate) arrivals: Receiver<Arrival>,
    /// With the backend or on its way there: set by the thread before it reads something, taken back by
    /// the render side when it gives one up, which may then be read again.
    pub(crate) claims: Arc<Marks>,
    /// In the present forecast: better kept than others.
    pub(crate) likely: Arc<Marks>,
    pub(crate) pool: Pool,
    /// The render side waits for an arrival.
    is_awaited: Arc<AtomicBool>,
}

impl IoThread {
    /// Starts the thread, which ends when this is dropped. Buffers take at most `cap` bytes, of which what
    /// is read ahead leaves `reserve`: the largest asset finds room, whatever waits to be taken in.
    pub(crate) fn start(
        source: impl Source + 'static,
        skeleton: Arc<Skeleton>,
        forecaster: Forecaster,
        far: Option<Arc<dyn FarField>>,
        [cap, reserve]: [u64; 2],
    ) -> std::io::Result<Self> {
        let (orders, inbox) = bounded(ORDERS);
        let (outbox, arrivals) = bounded(ARRIVALS);
        let (pool, returned) = Pool::new(cap, reserve);
        let marks = || Arc::new(Marks::new(&skeleton));
        let (claims, likely) = (marks(), marks());
        let is_awaited = Arc::new(AtomicBool::new(false));
        let reader = Reader {
            source,
            skeleton,
            forecaster,
            far,
            orders: inbox,
            arrivals: outbox,
            returned,
            pool: pool.clone(),
            claims: Arc::clone(&claims),
            likely: Arc::clone(&likely),
            is_awaited: Arc::clone(&is_awaited),
            fetched: VecDeque::new(),
            ahead: VecDeque::new(),
            next_forecast: None,
            with_textures: false,
            room: Room::default(),
            guesses: false,
            left_to_guess: 0,
        };
        std::thread::Builder::new().name("io".to_owned()).spawn(move || reader.run())?;
        Ok(Self { orders, arrivals, claims, likely, pool, is_awaited })
    }

    /// Gives a fetch command.
    pub(crate) fn fetch(&self, assets: Vec<Asset>, replaces: bool) {
        // The thread takes orders even while it waits to hand something over, so this ends. One that
        // broke down has said so; the frame that waits for it finds the channel closed.
        let _ = self.orders.send(Order::Fetch { assets, replaces });
    }

    /// Waits for the next arrival; none where the thread broke down.
    pub(crate) fn wait(&self) -> Option<Arrival> {
        self.is_awaited.store(true, Ordering::Release);
        let arrival = self.arrivals.recv().ok();
        self.is_awaited.store(false, Ordering::Release);
        arrival
    }

    /// Says what to read ahead. An order that finds the queue full is dropped: the next is newer.
    pub(crate) fn foresee(&self, order: Order) {
        let _ = self.orders.try_send(order);
    }
}

/// The thread's own side.
struct Reader<S> {
    source: S,
    skeleton: Arc<Skeleton>,
    forecaster: Forecaster,
    far: Option<Arc<dyn FarField>>,
    orders: Receiver<Order>,
    arrivals: Sender<Arrival>,
    returned: Receiver<()>,
    pool: Pool,
    claims: Arc<Marks>,
    likely: Arc<Marks>,
    is_awaited: Arc<AtomicBool>,
    /// L_O.
    fetched: VecDeque<Asset>,
    /// To be read ahead.
    ahead: VecDeque<Asset>,
    next_forecast: Option<(Outlook, Vec<Asset>)>,
    /// The forecast names textures, too.
    with_textures: bool,
    /// Bytes that the forecast may still take.
    room: Room,
    /// What the forecast names now is likely only for want of knowing what is hidden.
    guesses: bool,
    /// Bytes of guesses that may still be read under this forecast.
    left_to_guess: u64,
}

/// The render side is gone.
struct Gone;

impl<S: Source> Reader<S> {
    fn run(mut self) {
        while self.step().is_ok() {}
    }

    /// Takes all orders, then reads one asset.
    fn step(&mut self) -> Result<(), Gone> {
        loop {
            match self.orders.try_recv() {
                Ok(order) => self.take(order),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return Err(Gone),
            }
        }
        let Some((asset, foreseen)) = self.next() else {
            let order = self.orders.recv().map_err(|_| Gone)?;
            self.take(order);
            return Ok(());
        };
        let length = asset.file_bytes(&self.skeleton);
        let Some(mut buffer) = self.pool.take(length as usize, foreseen) else {
            let back = if foreseen { &mut self.ahead } else { &mut self.fetched };
            back.push_front(asset);
            let orders = self.orders.clone();
            select! {
                recv(orders) -> order => self.take(order.map_err(|_| Gone)?),
                recv(self.returned) -> _ => {}
            }
            return Ok(());
        };
        if !self.claims.set(asset) {
            return Ok(());
        }
        let bytes = self.source.read(asset, &mut buffer).map(|()| buffer);
        self.hand_over(Arrival { asset, bytes, foreseen })?;
        // The scheduler would let this thread read on for a millisecond before it runs the one that waits
        // for what is read.
        if self.fetched.is_empty() && self.is_awaited.load(Ordering::Acquire) {
            std::thread::yield_now();
        }
        Ok(())
    }

    fn take(&mut self, order: Order) {
        match order {
            Order::Fetch { assets, replaces } => {
                if replaces {
                    self.fetched.clear();
                }
                // What a drawing lacks, once: so much and no more may wait.
                let mut waits: BTreeSet<Asset> = self.fetched.iter().copied().collect();
                self.fetched.extend(assets.into_iter().filter(|&asset| waits.insert(asset)));
            }
            Order::Foresee { outlook, in_use, room, textures } => {
                (self.room, self.with_textures) = (room, textures);
                self.next_forecast = Some((outlook, in_use))
            }
        }
    }

    /// What to read next and is not claimed; whether it is read ahead.
    fn next(&mut self) -> Option<(Asset, bool)> {
        while let Some(asset) = self.fetched.pop_front() {
            if !self.claims.has(asset) {
                return Some((asset, false));
            }
        }
        loop {
            // The newest forecast is the best: what an older one did not come to goes.
            if let Some((outlook, in_use)) = self.next_forecast.take() {
                self.ahead.clear();
                self.likely.clear_all();
                (self.guesses, self.left_to_guess) = (false, GUESSED_BYTES);
                in_use.into_iter().for_each(|asset| _ = self.likely.set(asset));
                // Cubes of the cells to come; they are drawn whatever is visible.
                for camera in &outlook.ahead {
                    let wanted = self.far.as_ref().map(|far| far.wanted(camera.eye));
                    let blobs = wanted.into_iter().flatten();
                    blobs.for_each(|blob| self.expect(Asset::Blob(blob)));
                }
                self.forecaster.begin(outlook);
            }
            while let Some(asset) = self.ahead.pop_front() {
                if !self.claims.has(asset) && self.may_read_ahead(asset) {
                    return Some((asset, true));
                }
            }
            if !self.orders.is_empty() {
                return None;
            }
            if self.room.blobs == 0 {
                return None;
            }
            let (event, levels) = self.forecaster.next_levels()?;
            self.guesses = event.is_guess();
            let (skeleton, textures) = (Arc::clone(&self.skeleton), self.with_textures);
            let blobs = levels.iter().flat_map(|&level| skeleton.blobs_of(level));
            let named = blobs.flat_map(|blob| needs(&skeleton, blob, textures));
            named.for_each(|asset| self.expect(asset));
        }
    }

    /// Whether something named is worth the time it takes from those who draw.
    fn may_read_ahead(&mut self, asset: Asset) -> bool {
        if !self.guesses {
            return true;
        }
        let may = self.left_to_guess > 0;
        let bytes = asset.file_bytes(&self.skeleton);
        self.left_to_guess = self.left_to_guess.saturating_sub(bytes);
        may
    }

    /// Marks an asset as likely to be needed, and has it read if it is not there, as long as there is room
    /// for all that is likely.
    fn expect(&mut self, asset: Asset) {
        let length = asset.stored_bytes(&self.skeleton);
        if self.likely.has(asset) || length > BESIDES_BYTES {
            return;
        }
        let room = match asset {
            Asset::Blob(_) => &mut self.room.blobs,
            Asset::Texture(_) => &mut self.room.textures,
        };
        if length > *room {
            // What comes after is needed less.
            *room = 0;
            return;
        }
        *room -= length;
        self.likely.set(asset);
        self.ahead.push_back(asset);
    }

    fn hand_over(&mut self, arrival: Arrival) -> Result<(), Gone> {
        let mut arrival = Some(arrival);
        let (outbox, orders) = (self.arrivals.clone(), self.orders.clone());
        loop {
            if let Err(refused) = outbox.try_send(arrival.take().expect("kept until it is sent")) {
                if refused.is_disconnected() {
                    return Err(Gone);
                }
                arrival = Some(refused.into_inner());
            } else {
                return Ok(());
            }
            // Full: wait for room or for an order, whichever comes first. Orders must be taken, or
            // both sides could wait for each other.
            let mut waiting = crossbeam_channel::Select::new();
            waiting.send(&outbox);
            waiting.recv(&orders);
            waiting.ready();
            match orders.try_recv() {
                Ok(order) => self.take(order),
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => return Err(Gone),
            }
        }
    }
}
