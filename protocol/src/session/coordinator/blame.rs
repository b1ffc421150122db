//! Whom a run is held up by, in a sentence that says what to do.

use super::{Coordinator, Stage};
use crate::id::{FrameIndex, Seat};
use crate::schedule::{self, Phase, Role, SEATS};
use crate::settings::RunSettings;
use crate::telemetry::Nanos;

impl Coordinator {
    /// Why nothing has come for so long. The nodes answer pings: what hangs is a thread of theirs.
    pub(super) fn blame(&self, now: Nanos) -> String {
        let seconds = now.saturating_sub(self.began) / 1_000_000_000;
        match self.stage {
            Stage::Running(phase) => {
                let at = |(seat, role, frame): &(Seat, Role, FrameIndex)| {
                    format!("seat {seat} has been at {}({frame}) for {seconds} s", role.short())
                };
                let late: Vec<String> = self.holding_up(phase).iter().map(at).collect();
                format!(
                    "{} and still answers pings: its render thread hangs, in a driver or on a disk; restart \
                     that, or raise --phase-limit if its work takes so long",
                    late.join("; ")
                )
            }
            _ => {
                let owed: Vec<String> =
                    SEATS.iter().filter_map(|&seat| self.owed_at_the_end(seat)).collect();
                format!(
                    "{} after {seconds} s: its disk or its picture thread hangs; restart that, or raise \
                     --phase-limit if it takes so long",
                    owed.join("; ")
                )
            }
        }
    }

    /// The seats that have not reported, less those that wait for the visible set of one of them.
    fn holding_up(&self, phase: Phase) -> Vec<(Seat, Role, FrameIndex)> {
        let RunSettings { schedule, frames, .. } = self.settings;
        let late = self.links.members().iter().filter(|member| !member.is_done);
        let late: Vec<_> = late
            .filter_map(|member| {
                let (role, frame) = schedule::role(schedule, member.seat, phase, frames)?;
                Some((member.seat, role, frame))
            })
            .collect();
        let cull = late.iter().find(|(_, role, _)| *role == Role::HardwareCull);
        let waiting = cull.map_or(vec![], |&(.., frame)| schedule::receivers(schedule, frame));
        late.into_iter().filter(|(seat, ..)| !waiting.contains(seat)).collect()
    }

    fn owed_at_the_end(&self, seat: Seat) -> Option<String> {
        let member = self.links.members().iter().find(|member| member.seat == seat)?;
        let pictures = self.unhashed(seat).count();
        (!member.is_gone)
            .then(|| format!("seat {seat} has {pictures} pictures not hashed and no leave taken"))
    }

    /// Why the seats' renderers are not one; none if they are.
    ///
    /// What an occluder covers is rounded by the driver, so a mesh that one renderer finds hidden may
    /// show a pixel with another.
    pub(super) fn different_renderers(&self) -> Option<String> {
        let renderers = || self.links.members().iter().map(|member| &member.renderer);
        if renderers().zip(renderers().skip(1)).all(|(a, b)| a == b) {
            return None;
        }
        let named = self.links.members().iter().filter_map(|member| {
            let renderer = member.renderer.as_ref()?;
            Some(format!("seat {} with {} ({})", member.seat, renderer.name, renderer.driver))
        });
        let named: Vec<String> = named.collect();
        Some(format!(
            "the seats draw with different renderers, so visible pixels could be lost: {}; give all the \
             same with --backend cpu or --backend gpu, or add --mixed and get pictures that are not exact",
            named.join(", ")
        ))
    }
}
