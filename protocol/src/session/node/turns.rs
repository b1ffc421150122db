//! What a message causes: whose turn it is, and which work begins.

use super::sets::Ended;
use super::{Beat, Membership, Node, Output, Peer, Progress, Stage};
use crate::camera::Camera;
use crate::id::{FrameIndex, Seat};
use crate::message::Message;
use crate::schedule::{self, Phase, Role, SEATS};
use crate::telemetry::{IoCounts, Nanos};
use crate::visible::{ChangeWriter, VisibleSet};
use std::sync::Arc;

/// Frames before the present one whose sets are kept: the oldest base is three back, and it may be
/// asked for whole one frame late.
const FRAMES_KEPT: u32 = 4;

impl Node {
    pub(super) fn hear_coordinator(&mut self, now: Nanos, message: Message) -> Result<(), String> {
        match message {
            Message::Welcome { seat, peers, settings } if self.stage == Stage::Joining => {
                let all = SEATS.iter().all(|seat| peers.iter().any(|peer| peer.seat == *seat));
                if !SEATS.contains(&seat) || !all || peers.len() != SEATS.len() {
                    return Err("sent a welcome without three seats".into());
                }
                if settings.frames == 0 || settings.frames > i32::MAX as u32 - 2 {
                    return Err(format!("announced a run of {} frames", settings.frames));
                }
                self.stage = Stage::Preparing;
                self.membership = Some(Membership { seat, settings: settings.clone() });
                self.outputs.push_back(Output::Prepare { seat, settings, peers });
                Ok(())
            }
            Message::Phase { phase, next_camera } if self.stage == Stage::Running => {
                self.begin_phase(now, phase, next_camera)
            }
            Message::Finish if self.stage == Stage::Running && self.has_reported_last_phase() => {
                self.stage = Stage::Leaving;
                self.leave_if_done();
                Ok(())
            }
            Message::Failed { kind, reason } => {
                self.stage = Stage::Ended;
                self.outputs.push_back(Output::Failed { kind, reason });
                Ok(())
            }
            other => Err(format!("sent {} out of turn", other.name())),
        }
    }

    pub(super) fn hear_seat(
        &mut self,
        now: Nanos,
        seat: Seat,
        message: Message,
    ) -> Result<(), String> {
        let name = message.name();
        let out_of_turn = move || format!("sent {name} out of turn");
        let Some(Membership { seat: own, settings }) = &self.membership else {
            return Err(out_of_turn());
        };
        let (own, schedule) = (*own, settings.schedule);
        match message {
            Message::Delta { frame, base, chunk } => {
                self.check_sender(seat, own, frame).ok_or_else(out_of_turn)?;
                self.sets.chunk(frame, base, &chunk)
            }
            Message::EndOfFrame { frame, visible, checksum } => {
                self.check_sender(seat, own, frame).ok_or_else(out_of_turn)?;
                let base = schedule::delta_base(schedule, frame);
                match self.sets.end(now, frame, base, (visible, checksum))? {
                    Ended::Complete => self.start_work(now),
                    Ended::AskWhole => self.send(Peer::Seat(seat), Message::WantFull { frame }),
                }
                Ok(())
            }
            Message::WantFull { frame } => {
                let is_ours = schedule::seat_of(schedule, Role::HardwareCull, frame) == own
                    && schedule::receivers(schedule, frame).contains(&seat);
                let whole = self.sets.whole(frame).filter(|_| is_ours);
                let (chunks, set) = whole.ok_or_else(out_of_turn)?;
                let to = Peer::Seat(seat);
                for chunk in chunks {
                    self.send(to, Message::Delta { frame, base: None, chunk });
                }
                let (visible, checksum) = (set.len() as u32, set.checksum());
                self.send(to, Message::EndOfFrame { frame, visible, checksum });
                Ok(())
            }
            Message::Pong { .. } => Ok(()),
            Message::Failed { kind, reason } => {
                self.fail(kind, format!("seat {seat}: {reason}"));
                Ok(())
            }
            _ => Err(out_of_turn()),
        }
    }

    /// Whether `seat` may speak of V_`frame` now: it culls that frame, this node is a receiver and
    /// does not hold it yet. A peer may be one phase ahead; a set that is wanted as a base only may
    /// come a phase late.
    fn check_sender(&self, seat: Seat, own: Seat, frame: FrameIndex) -> Option<()> {
        let settings = self.settings();
        let culler = schedule::seat_of(settings.schedule, Role::HardwareCull, frame);
        let phase = self.beat.as_ref()?.phase.0;
        let near = i64::from(frame.0) - i64::from(phase);
        let expected = seat == culler
            && frame.0 < settings.frames
            && (-1..=1).contains(&near)
            && self.sets.get(frame).is_none()
            && schedule::receivers(settings.schedule, frame).contains(&own);
        expected.then_some(())
    }

    fn begin_phase(
        &mut self,
        now: Nanos,
        phase: Phase,
        next_camera: Option<Camera>,
    ) -> Result<(), String> {
        let Some(Membership { seat, settings }) = &self.membership else {
            return Err("began a phase before its welcome".into());
        };
        let expected = self.beat.as_ref().map_or(Phase::FIRST, |beat| beat.phase.next());
        let at_rest = self.beat.as_ref().is_none_or(|beat| beat.progress == Progress::Done);
        if phase != expected
            || !at_rest
            || phase > schedule::last_phase(settings.schedule, settings.frames)
        {
            return Err(format!("began phase {} out of turn", phase.0));
        }
        let next = phase.next().0 as u32;
        if next_camera.is_some() != (next < settings.frames) {
            return Err(format!("began phase {} with a camera too many or too few", phase.0));
        }
        if let Some(camera) = next_camera {
            if !is_finite(&camera) {
                return Err(format!("sent a camera of frame {next} that is not finite"));
            }
            self.cameras.insert(FrameIndex(next), camera);
        }
        let role = schedule::role(settings.schedule, *seat, phase, settings.frames);
        let oldest = FrameIndex(next.saturating_sub(1 + FRAMES_KEPT));
        self.cameras = self.cameras.split_off(&oldest);
        self.sets.forget_before(oldest);
        let progress = match role {
            None => Progress::Done,
            Some((Role::OcclusionRepresentation, FrameIndex(frame))) if frame > 0 => {
                Progress::Awaiting(FrameIndex(frame - 1))
            }
            Some((Role::RenderVisibleGeometry, frame)) => Progress::Awaiting(frame),
            Some(_) => Progress::Working,
        };
        self.beat = Some(Beat { phase, received: now, role, progress });
        match (progress, role) {
            (Progress::Done, _) => self.send_report(IoCounts::default(), None),
            (Progress::Working, Some((role, frame))) => self.output_work(role, frame, None),
            _ => self.start_work(now),
        }
        Ok(())
    }

    /// Starts what waits for a visible set, if that has come.
    fn start_work(&mut self, now: Nanos) {
        let Some(Beat { role: Some((role, frame)), progress, .. }) = &mut self.beat else { return };
        let Progress::Awaiting(wanted) = *progress else { return };
        let (role, frame) = (*role, *frame);
        match self.sets.get(wanted).map(|held| held.set.clone()) {
            Some(set) => {
                *progress = Progress::Working;
                self.watch.wait_for(now, None);
                self.output_work(role, frame, Some(set));
            }
            None => {
                let schedule = self.settings().schedule;
                let culler = schedule::seat_of(schedule, Role::HardwareCull, wanted);
                self.watch.wait_for(now, Some(culler));
            }
        }
    }

    fn output_work(&mut self, role: Role, frame: FrameIndex, set: Option<Arc<VisibleSet>>) {
        let camera = self.cameras[&frame];
        let set = set.unwrap_or_default();
        let output = match role {
            Role::OcclusionRepresentation => Output::Occlude { frame, camera, occluders: set },
            Role::RenderVisibleGeometry => {
                self.unhashed.insert(frame);
                Output::Render { frame, camera, visible: set }
            }
            Role::HardwareCull => {
                let base = schedule::delta_base(self.settings().schedule, frame);
                let base = self.sets.base(base);
                assert!(
                    base.is_some(),
                    "the schedule leaves the base of V_{frame} with its culler"
                );
                let hlods = self.sets.hlods();
                self.culling = base.map(|base| ChangeWriter::new(base, hlods));
                Output::Cull { frame, camera }
            }
        };
        self.outputs.push_back(output);
    }
}

fn is_finite(camera: &Camera) -> bool {
    let directions = camera.forward.iter().chain(&camera.up);
    camera.eye.iter().all(|c| c.is_finite())
        && directions.chain([&camera.tan_half_fov_y, &camera.near]).all(|c| c.is_finite())
}
