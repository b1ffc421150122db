//! No cracks: what two hlods share at their border is there in every level of both, until the hlod that
//! stands for both.

use super::*;
use std::collections::{BTreeMap, BTreeSet};

type Place = [u64; 3];

fn bits(p: DVec3) -> Place {
    // Plus zero makes one of the two zeros.
    p.to_array().map(|c| (c + 0.0).to_bits())
}

impl Baked {
    fn places(&self, level: &Level) -> BTreeSet<Place> {
        self.triangles(level).into_iter().flatten().map(bits).collect()
    }

    /// First and last leaf below each hlod, in the order of `order`.
    fn spans(&self, order: &mut Vec<HlodId>) -> Vec<(usize, usize)> {
        let skeleton = self.skeleton();
        let mut spans = vec![(usize::MAX, 0); skeleton.hlods.len()];
        let mut open = vec![HlodId(0)];
        while let Some(id) = open.pop() {
            let hlod = skeleton.hlod(id);
            if hlod.child_count == 0 {
                spans[id.index()] = (order.len(), order.len());
                order.push(id);
            }
            open.extend(skeleton.children_of(hlod).rev());
        }
        // A parent's number is less than its children's.
        for (id, hlod) in skeleton.hlods.iter().enumerate().rev() {
            if id > 0 {
                let (first, last) = spans[id];
                let parent = &mut spans[hlod.parent as usize];
                *parent = (parent.0.min(first), parent.1.max(last));
            }
        }
        spans
    }
}

#[test]
fn neighbours_share_their_border_at_every_level() {
    let options = Options { piece_triangles: 1000, ..Options::default() };
    let land = baked(&once(vec![terrain(174)]), &options);
    let skeleton = land.skeleton();
    assert_eq!(land.original_triangles(), 60_552);
    let mut order = Vec::new();
    let spans = land.spans(&mut order);
    assert!(order.len() >= 60, "{}", order.len());
    // Which leaves have a vertex in which place.
    let mut users: BTreeMap<Place, Vec<usize>> = BTreeMap::new();
    for (number, id) in order.iter().enumerate() {
        for place in land.places(&skeleton.levels_of(skeleton.hlod(*id))[0]) {
            users.entry(place).or_default().push(number);
        }
    }
    users.retain(|_, leaves| leaves.len() > 1);
    assert!(users.len() > 1000, "{}", users.len());
    let (mut coarse_levels, mut held) = (0, 0);
    for (index, hlod) in skeleton.hlods.iter().enumerate().skip(1) {
        let inside = spans[index].0..=spans[index].1;
        let border: Vec<&Place> = users
            .iter()
            .filter(|(_, leaves)| {
                leaves.iter().any(|leaf| inside.contains(leaf))
                    && leaves.iter().any(|leaf| !inside.contains(leaf))
            })
            .map(|(place, _)| place)
            .collect();
        assert!(!border.is_empty());
        let first = usize::from(hlod.child_count == 0);
        for level in skeleton.levels_of(hlod).iter().skip(first) {
            let places = land.places(level);
            // A mesh too large for the grid below it lies on a coarser one, leaves never.
            let part = skeleton.parts_of(level)[0];
            let reach = match hlod.child_count {
                0 => 0.0,
                _ => skeleton.blobs[part.blob as usize].step,
            };
            let is_there = |place: &Place| {
                let at = |k: usize| f64::from_bits(place[k]);
                let is_near = |other: &Place| {
                    (0..3).all(|k| (f64::from_bits(other[k]) - at(k)).abs() <= reach)
                };
                places.contains(place) || reach > 0.0 && places.iter().any(is_near)
            };
            let lost = border.iter().filter(|place| !is_there(place)).count();
            assert_eq!(lost, 0, "of {} in hlod {index}: {level:?}", border.len());
            assert!(reach < 1e-3, "{reach}");
            coarse_levels += 1;
            held += border.len();
        }
    }
    assert!(coarse_levels >= order.len() && held > 1000, "{coarse_levels} {held}");
}
