//! The far field of one cell: where samples are taken, the samples, and cubes of them.

use super::summary::CellSummary;
use super::{FarError, Settings};
use farfield::capture::{CaptureError, OfCell, Studio};
use farfield::cells::{Cell, MARGIN, up_axis};
use farfield::cube::{BakedCube, Viewpoints};
use farfield::placement;
use farfield::sample::Sample;
use farfield::worth::Views;
use farfield::{itdm, tdm};
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::{Method, Skeleton};
use protocol::settings::FAR_CUBES;
use scene::near_field::with_margin;
use std::time::Instant;

/// A cell's cubes before they are written.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FarFieldOf {
    pub(super) cubes: Vec<BakedCube>,
    pub(super) summary: CellSummary,
}

/// Places samples in a cell, takes them, and encodes them until it is plain that they do not pay.
pub(super) fn far_field(
    cell: &Cell,
    settings: &Settings,
    skeleton: &Skeleton,
    search: &mut Studio<'_>,
    fine: &mut Studio<'_>,
) -> Result<FarFieldOf, FarError> {
    let region = cell.region(up_axis(skeleton), settings.in_space);
    let [min, max] = with_margin(cell.min.to_array(), cell.max.to_array(), MARGIN).map(DVec3::from);
    let viewpoints = Viewpoints { min, max };
    let placing = Instant::now();
    let (eyes, objective) = match settings.method {
        Method::Tdm => (region.grid(1), Vec::new()),
        _ => {
            let how = placement::Settings {
                epsilon_sr: settings.epsilon_sr,
                budget: settings.samples,
                ..placement::Settings::default()
            };
            let mut source = OfCell { studio: search, near: &cell.near };
            let placed = placement::place(&region, &how, &mut source)?;
            let eyes = placed.samples.iter().map(|(sample, _)| sample.eye).collect();
            (eyes, placed.worst_sr)
        }
    };
    let placed = placing.elapsed().as_secs_f64();
    let sampling = Instant::now();
    let samples = eyes
        .iter()
        .map(|&eye| fine.sample(eye, &cell.near))
        .collect::<Result<Vec<Sample>, CaptureError>>()?;
    let sampled = sampling.elapsed().as_secs_f64();
    let encoding = Instant::now();
    let views = views_of(cell, settings);
    let geometry_in_view = views.of_geometry(skeleton, &cell.near);
    let (cubes, points, redundant) = match settings.method {
        Method::Tdm => (vec![tdm::encode(&samples[0], &viewpoints, settings.tolerance_px)], 0, 0),
        _ => {
            let tolerance = settings.tolerance_px;
            // The first cube is drawn from everywhere, all of them where they are few.
            let are_few = samples.len() <= FAR_CUBES as usize;
            let goes_on = |cubes: &[BakedCube]| {
                settings.always
                    || (cubes.len() > 1 && !are_few)
                    || views.of_cubes(cubes) < geometry_in_view
            };
            let encoded =
                itdm::encode(&samples, &viewpoints, tolerance, settings.all_intra, goes_on);
            (encoded.cubes, encoded.points, encoded.redundant)
        }
    };
    let cubes_in_view = views.of_cubes(&cubes);
    let summary = CellSummary {
        min: cell.min.to_array(),
        max: cell.max.to_array(),
        kept: settings.always || cubes_in_view < geometry_in_view,
        samples: eyes.len(),
        cubes: cubes.len(),
        objective,
        points,
        redundant,
        triangles: cubes.iter().map(BakedCube::triangles).sum(),
        cubes_in_view,
        geometry_in_view,
        near_triangles: cell.near.triangles(skeleton),
        bytes: 0,
        seconds: [placed, sampled, encoding.elapsed().as_secs_f64()],
    };
    Ok(FarFieldOf { cubes, summary })
}

/// The pictures that are taken in a cell.
fn views_of(cell: &Cell, settings: &Settings) -> Views {
    let inside = |view: &&Camera| cell.viewpoints.contains(&view.eye.into());
    let cameras: Vec<Camera> = settings.views.iter().filter(inside).copied().collect();
    Views::new(&cameras, settings.side)
}
