//! Passes under way, and what becomes of them.

use crate::queries::QueryBatch;
use crate::readback::{Readback, Signal};
use protocol::settings::PictureSize;
use scene::backend::{BackendError, Completion, NO_ITEM, Picture, Ticket};

/// What a submission brings.
pub(crate) enum Awaited {
    /// The occlusion depth.
    Occluders { done: Signal },
    /// Answers of one batch of queries.
    Queries { first: usize, count: usize, last: bool, batch: QueryBatch },
    /// Answers of a pass without a box.
    NoBoxes,
    /// Answers of the one-draw test, as one 32-bit mark a box.
    Marks { count: usize, answers: Readback },
    /// A picture, and its depth if asked for.
    Picture { size: PictureSize, color: Readback, depth: Option<Readback> },
    /// Item ids, and those of what blends unless nothing does.
    Items { size: PictureSize, items: Readback, blended: Option<Readback> },
}

/// One submission.
pub(crate) struct Pending {
    pub(crate) ticket: Ticket,
    /// None where nothing was submitted.
    pub(crate) submission: Option<wgpu::SubmissionIndex>,
    pub(crate) awaited: Awaited,
}

impl Awaited {
    /// Whether it has come.
    ///
    /// Errors: the device could not hand it over.
    pub(crate) fn is_ready(&self) -> Result<bool, BackendError> {
        let answers = match self {
            Self::NoBoxes => [None, None],
            Self::Occluders { done } => [Some(done), None],
            Self::Queries { batch, .. } => [Some(batch.answers.signal()), None],
            Self::Marks { answers, .. } => [Some(answers.signal()), None],
            Self::Items { items, blended, .. } => {
                [Some(items.signal()), blended.as_ref().map(Readback::signal)]
            }
            Self::Picture { color, depth, .. } => {
                [Some(color.signal()), depth.as_ref().map(Readback::signal)]
            }
        };
        let told = answers.into_iter().flatten().map(Signal::get);
        told.clone().all(|told| told != Some(false)).then_some(()).ok_or_else(|| {
            BackendError::Device("the device did not hand over a result".to_owned())
        })?;
        Ok(told.clone().all(|told| told == Some(true)))
    }
}

impl Pending {
    /// The completion, once ready; query batches go back to the pool.
    pub(crate) fn complete(self, pool: &mut Vec<QueryBatch>) -> Result<Completion, BackendError> {
        let ticket = self.ticket;
        Ok(match self.awaited {
            Awaited::Occluders { .. } => Completion::Occluders { ticket },
            Awaited::NoBoxes => {
                Completion::Boxes { ticket, first: 0, visible: Vec::new(), last: true }
            }
            Awaited::Queries { first, count, last, batch } => {
                let visible = batch.read(count)?;
                pool.push(batch);
                Completion::Boxes { ticket, first, visible, last }
            }
            Awaited::Marks { count, answers } => {
                let visible = answers.read(count as u64 * 4, |bytes| {
                    bytes.chunks_exact(4).map(|mark| mark.iter().any(|&b| b != 0)).collect()
                })?;
                Completion::Boxes { ticket, first: 0, visible, last: true }
            }
            Awaited::Picture { size, color, depth } => {
                let rgba = color.read_target(size)?;
                let depth = depth
                    .map(|depth| Ok(bytemuck::pod_collect_to_vec(&depth.read_target(size)?)))
                    .transpose()?;
                Completion::Picture { ticket, picture: Picture { rgba, depth } }
            }
            Awaited::Items { size, items, blended } => {
                let items: Vec<u32> = bytemuck::pod_collect_to_vec(&items.read_target(size)?);
                let blended = match blended {
                    Some(ids) => bytemuck::pod_collect_to_vec(&ids.read_target(size)?),
                    None => vec![NO_ITEM; items.len()],
                };
                Completion::Items { ticket, items, blended }
            }
        })
    }
}
