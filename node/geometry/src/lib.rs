//! Pure geometric kernels, one algorithm a file: slices and numbers in, slices and numbers out.

pub mod bounds;
pub mod deviation;
pub mod frustum;
pub mod hausdorff;
pub mod hierarchy;
pub mod mesh;
pub mod partition;
pub mod simplify;
pub mod weld;
