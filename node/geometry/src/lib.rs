//! Pure geometric kernels, one algorithm a file: slices and numbers in, slices and numbers out.

mod bottom_up;
pub mod bounds;
pub mod cluster;
pub mod codec;
pub mod criteria;
mod divide;
pub mod frustum;
pub mod hash;
pub mod hausdorff;
pub mod hierarchy;
mod lists;
pub mod mesh;
mod nearest;
pub mod partition;
pub mod pyramid;
pub mod simplify;
pub mod weld;
