use super::*;
use rand::{Rng, SeedableRng, rngs::StdRng};

/// A picture and its camera, with the eye at 0.
struct Setting {
    projection: Projection,
    rng: StdRng,
}

impl Setting {
    /// Any field of view from 1 to 170 degrees, any shape of a picture, any direction.
    fn new(mut rng: StdRng) -> Self {
        let mut any = || -> [f64; 3] { std::array::from_fn(|_| rng.random_range(-1.0..1.0)) };
        let (target, up) = (any(), any());
        let fov = rng.random_range(1.0..170.0);
        let camera = Camera::look_at([0.0; 3], target, up, fov, 1e-3).unwrap();
        let size =
            PictureSize { width: rng.random_range(1..1500), height: rng.random_range(200..1500) };
        Self { projection: Projection::new(&camera, size), rng }
    }

    /// Where a point is seen, world units at view depth 1; none behind the eye.
    fn seen(&self, p: DVec3) -> Option<[f64; 2]> {
        let Basis { right, up, forward } = self.projection.axes;
        let depth = forward.dot(p);
        (depth > 0.0).then(|| [right.dot(p) / depth, up.dot(p) / depth])
    }

    fn is_in_picture(&self, p: DVec3) -> bool {
        let reach = self.projection.tan_half;
        self.seen(p).is_some_and(|at| (0..2).all(|k| at[k].abs() <= reach[k]))
    }

    /// A point of the picture, often at its rim or in a corner.
    fn point(&mut self) -> DVec3 {
        let Projection { axes, tan_half, .. } = self.projection;
        let [x, y] = tan_half.map(|reach| {
            let share: f64 = self.rng.random_range(-1.0..1.0);
            reach * if self.rng.random_bool(0.4) { 0.999_999 * share.signum() } else { share }
        });
        let depth = 10f64.powf(self.rng.random_range(-2.0..4.0));
        (axes.forward + axes.right * x + axes.up * y) * depth
    }

    /// A box around a point: a flat one, a long one, or none of these.
    fn box_around(&mut self, p: DVec3) -> Aabb {
        let mut reach = || {
            DVec3::from_array(std::array::from_fn(|_| {
                p.length() * 10f64.powf(self.rng.random_range(-5.0..0.3))
            }))
        };
        Aabb { min: p - reach(), max: p + reach() }
    }

    /// A unit vector: any, or the one that moves the picture of `p` farthest from its middle.
    fn direction(&mut self, p: DVec3, error: f64) -> DVec3 {
        let forward = self.projection.axes.forward;
        if self.rng.random_bool(0.5) {
            return DVec3::from_array(std::array::from_fn(|_| self.rng.random_range(-1.0..1.0)))
                .normalize_or(DVec3::X);
        }
        // Square to the ray that touches the ball.
        let ray = p.normalize();
        let outwards = (ray - forward * forward.dot(ray)).normalize_or(DVec3::X);
        let square = outwards * forward.dot(ray) - forward * outwards.dot(ray);
        let sine = (error / p.length()).min(1.0);
        square * (1.0 - sine * sine).sqrt() - ray * sine
    }

    /// Pixels between two points as they are seen.
    fn apart_px(&self, p: DVec3, q: DVec3) -> f64 {
        match (self.seen(p), self.seen(q)) {
            (Some(p), Some(q)) => (p[0] - q[0]).hypot(p[1] - q[1]) / self.projection.pixel,
            _ => f64::INFINITY,
        }
    }
}

/// Runs `visit` with many settings.
fn settings(count: u64, mut visit: impl FnMut(&mut Setting)) {
    for seed in 0..count {
        visit(&mut Setting::new(StdRng::seed_from_u64(seed)));
    }
}

#[test]
fn a_million_projections_stay_within_the_pixels_allowed() {
    let (mut tightest, mut by_distance, mut count) = (0.0f64, 0u32, 0u32);
    settings(10_000, |setting| {
        for _ in 0..70 {
            let seen = setting.point();
            let bounds = setting.box_around(seen);
            let lod_px = 10f64.powf(setting.rng.random_range(-2.0..3.0));
            let error = setting.projection.allowed_error(&bounds, lod_px);
            let distance = bounds.distance(DVec3::ZERO);
            let by_angle = lod_px * setting.projection.pixel * distance;
            assert_eq!(error == 0.0, distance == 0.0, "{bounds:?}");

            let mut moved = |p: DVec3, error: f64| {
                let q = p + setting.direction(p, error) * error;
                let is_seen = setting.is_in_picture(p) || setting.is_in_picture(q);
                is_seen.then(|| setting.apart_px(p, q) / lod_px)
            };
            // The point of the level is seen, or the original of one that need not be.
            let corner = DVec3::select(seen.cmplt(DVec3::ZERO), bounds.min, bounds.max);
            for p in [seen, corner] {
                let Some(share) = moved(p, error) else { continue };
                assert!(share <= 1.0, "{bounds:?} {lod_px}: {share}");
                tightest = tightest.max(share);
                count += 1;
            }

            // What an angle in place of pixels would allow.
            by_distance += u32::from(moved(seen, by_angle).is_some_and(|share| share > 1.01));
        }
    });
    assert!(count >= 1_000_000, "{count}");
    assert!(tightest > 0.999, "{tightest}: more could be allowed");
    assert!(by_distance > 100_000, "{by_distance}: a weak test");
}

#[test]
fn no_point_of_a_box_is_seen_farther_away_than_is_told() {
    let mut tightest = 0.0f64;
    settings(2_000, |setting| {
        let diagonal = setting.projection.diagonal_px;
        for _ in 0..50 {
            let seen = setting.point();
            let bounds = setting.box_around(seen);
            let error = seen.length() * 10f64.powf(setting.rng.random_range(-5.0..0.2));
            let q = seen + setting.direction(seen, error) * error;
            let apart = setting.apart_px(seen, q).min(diagonal);

            let told = setting.projection.moved_px(&bounds, error);
            assert!(apart <= told * (1.0 + 1e-9) && told <= diagonal, "{apart} {told}");
            let depth = setting.projection.axes.forward.dot(seen);
            let [x, y] = setting.seen(seen).unwrap();
            let at_point = setting.projection.moved_at_px(depth, x.hypot(y), error);
            assert!(apart <= at_point * (1.0 + 1e-9) && at_point <= told * (1.0 + 1e-9));
            if at_point < diagonal {
                tightest = tightest.max(apart / at_point);
            }
        }
    });
    assert!(tightest > 0.9999, "{tightest}");
}

#[test]
fn what_is_allowed_is_as_many_pixels_as_were_asked_for() {
    settings(200, |setting| {
        let p = setting.point();
        let bounds = Aabb { min: p, max: p };
        let mut least = 0.0;
        for lod_px in [1e-3, 0.1, 1.0, 8.0, 1e9] {
            let error = setting.projection.allowed_error(&bounds, lod_px);
            assert!(error > least, "more pixels allow no less");
            least = error;
            let told = setting.projection.moved_px(&bounds, error);
            assert!(told <= lod_px, "{told} {lod_px}");
        }
        let [wide, narrow] =
            [1e3, 1e-3].map(|lod_px| setting.projection.allowed_error(&bounds, lod_px) / lod_px);
        assert!(wide < narrow, "an error that is large beside the distance is seen as more");
    });
}

#[test]
fn a_box_that_holds_the_eye_allows_nothing_and_shows_anything() {
    settings(50, |setting| {
        let p = setting.point();
        let diagonal = setting.projection.diagonal_px;
        let around = Aabb { min: -p.abs(), max: p.abs() };
        let point = Aabb { min: DVec3::ZERO, max: DVec3::ZERO };
        for bounds in [around, point] {
            assert_eq!(setting.projection.allowed_error(&bounds, 5.0), 0.0);
            assert_eq!(setting.projection.moved_px(&bounds, 1.0), diagonal);
            assert_eq!(setting.projection.moved_px(&bounds, 0.0), 0.0);
        }
        let beside = Aabb { min: p, max: p };
        assert_eq!(setting.projection.allowed_error(&beside, 0.0), 0.0);
        assert_eq!(setting.projection.moved_px(&beside, f64::MAX.sqrt()), diagonal);
        let huge = Aabb { min: p.abs(), max: DVec3::splat(f64::MAX / 8.0) };
        assert!(setting.projection.allowed_error(&huge, 1.0) > 0.0);
    });
}
