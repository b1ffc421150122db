//! Passes in parts: draws that together need more memory than there is, one stretch after the other.

use super::{Pass, Shading, View};
use std::mem::{Discriminant, discriminant};

/// Where a stretch of draws stands in its pass.
///
/// The parts of a pass follow each other with nothing between but uploads and evictions. All have the
/// same view and shading, and solid draws come before any that blend. Only the last is answered. Then the answer is,
/// bit for bit, that of the pass in one part, wherever the lists are cut: [`super::Draws::solid`] between
/// blobs, [`super::Draws::blending`] anywhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// It clears what it draws into; another goes on with what the last part left.
    pub opens: bool,
    /// It is the last: the pass is answered.
    pub closes: bool,
}

impl Part {
    /// A pass in one part.
    pub const WHOLE: Self = Self { opens: true, closes: true };
}

/// The pass that a backend is in, between its parts.
#[derive(Debug, Default)]
pub struct UnderWay(Option<Begun>);

#[derive(Debug)]
struct Begun {
    kind: Discriminant<Pass>,
    view: View,
    shading: Option<Shading>,
    /// Something that blends was drawn.
    blends: bool,
}

impl UnderWay {
    /// Holds the next pass to the rules of [`Part`], the breach of which is the caller's mistake and
    /// panics.
    pub fn take(&mut self, pass: &Pass) {
        let (view, solid, blends, part) = match pass {
            Pass::Occluders { view, draws, part, .. } => (view, !draws.is_empty(), false, *part),
            Pass::QueryBoxes { view, .. } | Pass::QueryMeshes { view, .. } => {
                (view, false, false, Part::WHOLE)
            }
            Pass::Shade { view, draws, part, .. } | Pass::Items { view, draws, part } => {
                (view, !draws.solid.is_empty(), !draws.blending.is_empty(), *part)
            }
        };
        let shading = match pass {
            Pass::Shade { shading, .. } => Some(*shading),
            _ => None,
        };
        let kind = discriminant(pass);
        let begun = self.0.take();
        assert_eq!(begun.is_none(), part.opens, "a pass ends before the next begins");
        let before = begun.unwrap_or(Begun { kind, view: *view, shading, blends: false });
        let is_same = before.kind == kind && before.view == *view && before.shading == shading;
        assert!(is_same, "parts of one pass");
        assert!(!(before.blends && solid), "what is solid comes before what blends");
        if !part.closes {
            self.0 = Some(Begun { blends: before.blends || blends, ..before });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Draw, Draws};
    use super::*;
    use protocol::id::{BlobId, HlodId};
    use protocol::settings::{Cull, PictureSize};

    const OPENS: Part = Part { opens: true, closes: false };
    const GOES_ON: Part = Part { opens: false, closes: false };
    const CLOSES: Part = Part { opens: false, closes: true };

    fn view(width: u32) -> View {
        View { size: PictureSize { width, height: 1 }, clip_from_eye: [[0.0; 4]; 4] }
    }

    fn items(solid: usize, blending: usize, part: Part) -> Pass {
        let (blob, item) = (BlobId(0), HlodId(0));
        let draw = Draw {
            blob,
            item,
            linear: [[0.0; 3]; 3],
            offset: [0.0; 3],
            distance: 0.0,
            disparity_step: 0.0,
        };
        let draws = Draws { solid: vec![draw; solid], blending: vec![draw; blending] };
        Pass::Items { view: view(1), draws, part }
    }

    fn occluders(width: u32, part: Part) -> Pass {
        Pass::Occluders { view: view(width), draws: vec![], adds: false, part }
    }

    fn boxes() -> Pass {
        Pass::QueryBoxes { view: view(1), boxes: vec![], method: Cull::Queries }
    }

    fn shade(shading: Shading, part: Part) -> Pass {
        Pass::Shade { view: view(1), shading, draws: Draws::default(), with_depth: false, part }
    }

    fn are_taken(passes: &[Pass]) -> bool {
        let take = || {
            let mut under_way = UnderWay::default();
            passes.iter().for_each(|pass| under_way.take(pass));
        };
        std::panic::catch_unwind(take).is_ok()
    }

    #[test]
    fn parts_in_turn_are_taken() {
        let parts = [items(1, 0, OPENS), items(2, 1, GOES_ON), items(0, 1, CLOSES)];
        assert!(are_taken(&parts));
        let passes =
            [occluders(1, Part::WHOLE), boxes(), occluders(1, OPENS), occluders(1, CLOSES)];
        assert!(are_taken(&[&passes[..], &parts[..], &[boxes()]].concat()));
    }

    #[test]
    fn parts_out_of_turn_are_found_out() {
        assert!(!are_taken(&[items(1, 0, GOES_ON)]), "none before it");
        assert!(!are_taken(&[items(1, 0, OPENS), items(1, 0, OPENS)]), "begun twice");
        assert!(!are_taken(&[items(1, 0, OPENS), boxes()]), "another pass between");
        assert!(!are_taken(&[items(1, 0, OPENS), occluders(1, CLOSES)]), "another pass");
        let begun = shade(Shading::default(), OPENS);
        assert!(!are_taken(&[begun, shade(Shading::Normals, CLOSES)]), "another shading");
        assert!(!are_taken(&[occluders(1, OPENS), occluders(2, CLOSES)]), "another view");
        assert!(!are_taken(&[items(0, 1, OPENS), items(1, 0, CLOSES)]), "solid behind blending");
    }
}
