//! The WGSL sources and the Rust mirrors of their structs.
//!
//! WGSL has no include, so each source here is the shared text followed by the pass's own. A test
//! parses and validates all of them and compares every mirror with what the parser read.

pub mod mirror;

macro_rules! source {
    ($($file:literal),+) => {
        concat!($(include_str!(concat!("../", $file)), "\n"),+)
    };
}

/// Occluders: entry point `vertex_main`, depth alone.
pub const DEPTH: &str = source!("frame.wgsl", "mesh.wgsl", "depth.wgsl");
/// The picture: entry points `vertex_main`, `fragment_main`.
pub const SHADE: &str = source!("frame.wgsl", "mesh.wgsl", "shade.wgsl");
/// Item ids: entry points `vertex_main`, `fragment_main`.
pub const ITEMS: &str = source!("frame.wgsl", "mesh.wgsl", "items.wgsl");
/// Boxes as occlusion queries, entry point `query_vertex`: depth alone, a list of
/// [`BOX_VERTICES`] vertices an instance.
pub const BOX_QUERY: &str = source!("frame.wgsl", "box.wgsl", "box_query.wgsl");
/// Boxes that mark themselves, entry points `mark_vertex`, `mark_fragment`. It needs the early depth
/// test, which not every device has, and so is a module of its own.
pub const BOX_MARK: &str = source!("frame.wgsl", "box.wgsl", "box_mark.wgsl");

/// Vertices of the three faces of a box that can be turned to the eye, two triangles each.
pub const BOX_VERTICES: u32 = 18;
