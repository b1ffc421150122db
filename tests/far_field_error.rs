//! What far fields cost and gain: cells of a walk are baked, also those where geometry is cheaper, and the walk is
//! replayed with and without them.
//!
//! Every picture is held against the original geometry, without culling: the mean squared error of all channels
//! (PSNR), the signal-to-noise ratio of luminance (paper 003: the sum of squares of the original over that of the
//! difference), pixels of which a channel changed by more than 2% of its range, and holes: sky where there
//! is none. Means over every tenth frame; the ratios as the mean error says. Times are medians of the role that renders
//! the visible geometry. At a border between cells the change of the picture is compared with that one frame before.
//!
//! In release: `cargo test --release --test far_field_error -- --ignored --nocapture`; with
//! `FAR_FIELD_SCENES=plant,city_wageningen` only of these, with `FAR_FIELD_BAKE="--far-epsilon 0.5"` baked so.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use image::{Rgb, RgbImage};
use scene::store::Store;
use scene::view_cells::Cells;
use support::{Run, Scene, real_scene, succeed, text};

/// Triangles of the plant: the paper's.
const PLANT_TRIANGLES: u64 = 12_700_000;
/// Real scenes that the plant stands beside.
const SCENES: [&str; 3] = ["indoor_schependomlaan", "cad_ldraw_town_hall", "city_wageningen"];
/// Poses of a path, every other of which is walked.
const POSES: u32 = 240;
const WALKED: usize = POSES as usize / 2;
/// Every so many frames one is compared.
const STEP: usize = 10;
const SIZE: &str = "640x360";
/// Difference of a channel that is not seen: 2% of its range.
const UNSEEN: u8 = 5;
/// Cubes that are drawn (paper 000, figure 11).
const CUBES: [&str; 5] = ["1", "2", "3", "6", "10"];

/// Pictures against their originals, sums over pixels.
#[derive(Debug, Clone, Copy, Default)]
struct Error {
    pixels: f64,
    /// Of all channels.
    squares: f64,
    /// Of luminance: of the difference, of the original.
    luminance: [f64; 2],
    changed: f64,
    holes: f64,
}

impl Error {
    fn add(&mut self, picture: &RgbImage, original: &RgbImage) {
        let luminance = |Rgb(c): &Rgb<u8>| {
            let [r, g, b] = c.map(f64::from);
            0.299 * r + 0.587 * g + 0.114 * b
        };
        let sky = sky();
        for (found, truth) in picture.pixels().zip(original.pixels()) {
            self.pixels += 1.0;
            let off: [u8; 3] = std::array::from_fn(|k| found[k].abs_diff(truth[k]));
            self.squares += off.iter().map(|&d| f64::from(d).powi(2)).sum::<f64>();
            self.luminance[0] += (luminance(found) - luminance(truth)).powi(2);
            self.luminance[1] += luminance(truth).powi(2);
            self.changed += f64::from(u8::from(off.iter().any(|&d| d > UNSEEN)));
            self.holes += f64::from(u8::from(found.0 == sky && truth.0 != sky));
        }
    }

    fn psnr(&self) -> f64 {
        10.0 * (255f64.powi(2) * 3.0 * self.pixels / self.squares).log10()
    }

    fn luminance_snr(&self) -> f64 {
        10.0 * (self.luminance[1] / self.luminance[0]).log10()
    }
}

/// The sky as pictures hold it.
fn sky() -> [u8; 3] {
    scene::backend::light::SKY.map(|linear| {
        let code = 1.055 * f64::from(linear).powf(1.0 / 2.4) - 0.055;
        (255.0 * code).round() as u8
    })
}

/// Root of the mean squared change of a channel from one frame to the next.
fn change(run: &Run, frame: usize) -> f64 {
    let mut sum = Error::default();
    sum.add(&run.picture(frame + 1), &run.picture(frame));
    (sum.squares / (3.0 * sum.pixels)).sqrt()
}

fn measure(name: &str, scene: &mut Scene) {
    let walk = scene.path("walk", POSES);
    let csv = std::fs::read_to_string(&walk).unwrap();
    let lines: Vec<&str> = csv.lines().take(1).chain(csv.lines().skip(1).step_by(2)).collect();
    let path = scene.file("walked.csv");
    std::fs::write(&path, lines.join("\n") + "\n").unwrap();
    let (plain, far) = (scene.occ.clone(), scene.file("far.occ"));
    let more = std::env::var("FAR_FIELD_BAKE").unwrap_or_default();
    let mut bake = vec!["bake", text(&plain), "-o", text(&far), "--far", "itdm"];
    bake.extend(["--far-always", "--cells-along", text(&path)]);
    bake.extend(more.split_whitespace());
    println!("{name}\n{}", String::from_utf8(succeed(&bake).stdout).unwrap());
    scene.occ = far;
    let frames = WALKED.to_string();
    let replay = |out: &str, more: &[&str]| {
        let mut options = vec!["--path", text(&path), "--size", SIZE, "--backend", "cpu"];
        options.extend(["--frames", &frames, "--pictures", "png"]);
        options.extend(more);
        scene.replay(out, &options)
    };
    // What all are held against comes first.
    let mut variants: Vec<(String, Vec<&str>)> = vec![
        ("original, culling off".into(), vec!["--far", "off", "--lod", "0", "--cull", "off"]),
        ("original".into(), vec!["--far", "off", "--lod", "0"]),
        ("static levels, 1 px, culling off".into(), vec!["--far", "off", "--cull", "off"]),
        ("levels, 1 px".into(), vec!["--far", "off"]),
    ];
    for cubes in CUBES {
        variants
            .push((format!("itdm, {cubes} cubes"), vec!["--far", "itdm", "--far-cubes", cubes]));
    }
    println!(
        "{:<33}{:>9}{:>9}{:>12}{:>10}{:>8}{:>8}{:>10}{:>8}",
        "", "RVG ms", "frame ms", "triangles", "far", "PSNR", "SNR Y", "changed %", "holes %"
    );
    let mut runs: Vec<Run> = Vec::new();
    for (number, (what, options)) in variants.iter().enumerate() {
        let run = replay(&format!("variant-{number}"), options);
        let original = runs.first().unwrap_or(&run);
        let mut error = Error::default();
        (0..WALKED).step_by(STEP).for_each(|at| error.add(&run.picture(at), &original.picture(at)));
        println!(
            "{what:<33}{:>9.1}{:>9.1}{:>12.0}{:>10.0}{:>8.1}{:>8.1}{:>10.2}{:>8.2}",
            run.number("/latency_ms/rvg/p50"),
            run.number("/frame_ms/p50"),
            run.number("/triangles/drawn/mean"),
            run.number("/triangles/far/mean"),
            error.psnr(),
            error.luminance_snr(),
            100.0 * error.changed / error.pixels,
            100.0 * error.holes / error.pixels,
        );
        runs.push(run);
    }
    borders(scene, &lines[1..], &runs[3], runs.last().unwrap());
}

/// Prints how much the picture changes where the eye goes from one cell to another, and where it changes most beside what
/// geometry does.
fn borders(scene: &Scene, poses: &[&str], geometry: &Run, cubes: &Run) {
    let store = Store::open(&scene.occ).unwrap();
    let method = protocol::format::Method::Itdm as u32;
    let cells = Cells::new(store.skeleton(), method);
    let cell = |pose: &&str| {
        let mut numbers = pose.split(',').map(|number| number.parse::<f64>().unwrap());
        cells.at(std::array::from_fn(|_| numbers.next().unwrap()))
    };
    let at: Vec<Option<usize>> = poses.iter().map(cell).collect();
    for frame in (1..at.len() - 1).filter(|&frame| at[frame] != at[frame + 1]) {
        let ratio = |run: &Run| change(run, frame) / change(run, frame - 1);
        println!(
            "from cell {:?} to {:?}: the picture changes {:.2} times as much as a frame before; geometry {:.2}",
            at[frame],
            at[frame + 1],
            ratio(cubes),
            ratio(geometry),
        );
    }
    let beside = |frame: usize| change(cubes, frame) / change(geometry, frame);
    let worst =
        (0..at.len() - 1).map(|frame| (beside(frame), frame)).max_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((most, frame)) = worst {
        println!(
            "no picture changes more than {most:.2} times as much as with geometry (frame {frame})"
        );
    }
}

#[test]
#[ignore = "bakes several cells of large scenes, takes many minutes; see the top of this file"]
fn far_fields_are_measured() {
    let wanted = std::env::var("FAR_FIELD_SCENES").ok();
    let is_wanted =
        |name: &str| wanted.as_ref().is_none_or(|all| all.split(',').any(|w| w == name));
    for name in SCENES.into_iter().filter(|name| is_wanted(name)) {
        if let Some(glb) = real_scene(name) {
            measure(name, &mut Scene::bake(&glb));
        }
    }
    if is_wanted("plant") {
        measure("plant", &mut Scene::synth("plant", PLANT_TRIANGLES));
    }
}

#[test]
fn errors_are_what_they_are_called() {
    let sky = Rgb(sky());
    let original = RgbImage::from_pixel(10, 10, Rgb([100; 3]));
    let mut same = Error::default();
    same.add(&original, &original);
    assert_eq!((same.squares, same.changed, same.holes), (0.0, 0.0, 0.0));
    let mut picture = original.clone();
    picture.put_pixel(3, 4, sky);
    picture.put_pixel(5, 5, Rgb([104; 3]));
    picture.put_pixel(6, 5, Rgb([100, 106, 100]));
    let mut found = Error::default();
    found.add(&picture, &original);
    let of_sky: f64 = sky.0.iter().map(|&c| (f64::from(c) - 100.0).powi(2)).sum();
    assert_eq!(found.squares, of_sky + 48.0 + 36.0);
    assert_eq!((found.pixels, found.changed, found.holes), (100.0, 2.0, 1.0));
    let mean = found.squares / 300.0;
    assert!((found.psnr() - 20.0 * (255.0 / mean.sqrt()).log10()).abs() < 1e-9);
    let signal = 100.0 * 100f64.powi(2);
    let noise = 10f64.powf(-found.luminance_snr() / 10.0) * signal;
    let [r, g, b] = sky.0.map(f64::from);
    let of_sky = (0.299 * r + 0.587 * g + 0.114 * b - 100.0).powi(2);
    assert!((noise - of_sky - 16.0 - (0.587f64 * 6.0).powi(2)).abs() < 1e-6, "{noise}");
}
