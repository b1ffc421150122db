//! Times `geometry::hausdorff`: nanoseconds a triangle, fine to coarse and back, on a wavy sheet and
//! its simplified forms.

use geometry::hausdorff::{Goal, Surface, directed, sampled};
use geometry::mesh::{Mesh, MeshVertex};
use geometry::simplify::simplify;
use geometry::weld::{Weld, weld};
use glam::{DVec3, Vec3};
use std::time::Instant;

fn sheet(side: u32, wave: f64) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..=side {
        for j in 0..=side {
            let (x, y) = (f64::from(i) / f64::from(side), f64::from(j) / f64::from(side));
            let z = wave * ((x * 9.0).sin() * (y * 7.0).cos() + 0.3 * (x * 31.0).sin());
            mesh.vertices.push(MeshVertex::plain(DVec3::new(x, y, z), Vec3::Z, [255; 4]));
        }
    }
    let at = |i: u32, j: u32| i * (side + 1) + j;
    for i in 0..side {
        for j in 0..side {
            mesh.triangles.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
            mesh.triangles.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    mesh
}

fn main() {
    for (name, wave) in [("flat", 0.0), ("gentle", 0.02), ("rough", 0.1)] {
        let fine = sheet(32, wave);
        for share in [2, 4, 16] {
            let target = fine.triangles.len() / share;
            let welded = weld(&fine, Weld::within(1e-9));
            let reduced = simplify(&welded, target, 0.5);
            let coarse = welded.with_triangles(&reduced.triangles, reduced.estimate).0;
            for enough in [0.0, 1.0] {
                report(name, &fine, &coarse, enough);
            }
        }
    }
}

/// A result, and the least time it took of some tries, ns.
fn least<T>(tries: u32, mut run: impl FnMut() -> T) -> (T, f64) {
    let mut timed = || {
        let start = Instant::now();
        (std::hint::black_box(run()), start.elapsed().as_secs_f64() * 1e9)
    };
    let mut best = timed();
    for _ in 1..tries {
        let next = timed();
        if next.1 < best.1 {
            best = next;
        }
    }
    best
}

fn report(name: &str, fine: &Mesh, coarse: &Mesh, share: f64) {
    let repeats = 20u32;
    let (_, build) = least(repeats, || Surface::new(fine));
    let mut line = format!(
        "{name:6} {:4} -> {:4}  build {:4.0}",
        fine.triangles.len(),
        coarse.triangles.len(),
        build / fine.triangles.len() as f64
    );
    for (from, to, label) in [(fine, coarse, "out"), (coarse, fine, "back")] {
        let to = Surface::new(to);
        let enough = sampled(from, &to, 4) * share;
        let goal = Goal { enough, slack: 0.1, budget: 100_000 };
        let (bound, spent) = least(repeats, || directed(from, &to, &goal));
        line += &format!(
            " | {label} enough {enough:.2e} upper {:.2e} lower {:.2e} {:5.0} ns",
            bound.upper,
            bound.lower,
            spent / from.triangles.len() as f64
        );
    }
    println!("{line}");
}
