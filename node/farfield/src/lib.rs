//! Stand-ins for what is far: view cells, samples of what is seen from them, and scan cubes made of these
//! (Wilson and Manocha, Simplifying Complex Environments using Incremental Textured Depth Meshes).

pub mod adjacency;
#[cfg(test)]
mod analytic;
pub mod capture;
pub mod cells;
pub mod cube;
pub mod depth_mesh;
pub mod field;
pub mod itdm;
pub mod method;
pub mod neighbours;
pub mod normals;
pub mod objective;
pub mod patches;
pub mod picture;
pub mod placement;
mod projection;
mod raster;
pub mod redundancy;
pub mod sample;
pub mod select;
pub mod sight;
mod skins;
pub mod solid_angle;
pub mod tdm;
pub mod tree;
pub mod voronoi;
mod wanted;
pub mod worth;
