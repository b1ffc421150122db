//! What was read and nobody has taken in yet, in the order it came.

use crate::io_thread::Arrival;
use scene::asset::Asset;
use std::collections::BTreeMap;

/// Arrivals that wait on the render side of the channel. Their buffers bound them.
#[derive(Debug, Default)]
pub(crate) struct Come {
    count: u64,
    in_order: BTreeMap<u64, Arrival>,
    places: BTreeMap<Asset, u64>,
    /// Of these, fetched ones.
    fetched: usize,
}

impl Come {
    /// Keeps one, which was read.
    pub(crate) fn keep(&mut self, arrival: Arrival) {
        self.count += 1;
        self.fetched += usize::from(!arrival.foreseen);
        self.places.insert(arrival.asset, self.count);
        self.in_order.insert(self.count, arrival);
    }

    /// Whether it waits here.
    pub(crate) fn has(&self, asset: Asset) -> bool {
        self.places.contains_key(&asset)
    }

    /// The one that has waited for longest.
    pub(crate) fn next(&self) -> Option<&Arrival> {
        self.in_order.values().next()
    }

    /// Hands that one out.
    pub(crate) fn take_next(&mut self) -> Option<Arrival> {
        self.take(self.next()?.asset)
    }

    /// Hands one out if it is here.
    pub(crate) fn take(&mut self, asset: Asset) -> Option<Arrival> {
        let arrival = self.in_order.remove(&self.places.remove(&asset)?)?;
        self.fetched -= usize::from(!arrival.foreseen);
        Some(arrival)
    }

    /// Drops those that were fetched, and with them their buffers; which they were.
    pub(crate) fn drop_fetched(&mut self) -> Vec<Asset> {
        if self.fetched == 0 {
            return Vec::new();
        }
        let fetched = self.in_order.values().filter(|arrival| !arrival.foreseen);
        let assets: Vec<Asset> = fetched.map(|arrival| arrival.asset).collect();
        for &asset in &assets {
            self.take(asset);
        }
        assets
    }
}

impl Extend<Arrival> for Come {
    fn extend<T: IntoIterator<Item = Arrival>>(&mut self, arrivals: T) {
        arrivals.into_iter().for_each(|arrival| self.keep(arrival));
    }
}
