//! What the tree is built of, from the bottom up: hlods ready to be written, and what their parents
//! must know of them. All of it can lie on disk, so that a bake that was cut short goes on.

use crate::bytes::{Decoder, Encoder, Torn};
use crate::pack::Packed;
use geometry::bounds::Aabb;
use geometry::mesh::{Mesh, MeshVertex};
use glam::{DVec3, Vec3};
use protocol::id::BlobId;

/// Where a part's mesh is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Geometry {
    /// To be written.
    Packed(Packed),
    /// In the file already, as part of a shared mesh.
    Written {
        blob: BlobId,
        /// Where the part is placed, scene units.
        longest_edge: f64,
    },
}

/// A part of a level that is not numbered yet.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PendingPart {
    pub(crate) geometry: Geometry,
    pub(crate) transform: u32,
}

/// A level that is not numbered yet.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PendingLevel {
    pub(crate) error: f64,
    pub(crate) triangles: u32,
    pub(crate) parts: Vec<PendingPart>,
}

/// An hlod ready to be written.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Built {
    /// Its id.
    pub(crate) node: u32,
    /// Finest first.
    pub(crate) levels: Vec<PendingLevel>,
    pub(crate) bounds: Aabb,
    pub(crate) source_triangles: u64,
    pub(crate) object: u32,
}

/// What stands for an hlod when its parent is made, at one level.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Form {
    /// How far it strays from the original surface.
    pub(crate) error: f64,
    pub(crate) triangles: usize,
    pub(crate) shape: Shape,
}

/// The geometry of a [`Form`], in the world.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Shape {
    /// One mesh.
    Mesh(Mesh),
    /// Levels of shared pieces where objects show them: (member, level).
    Parts(Vec<[u32; 2]>),
}

/// An hlod and what its parent must know of it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Top {
    pub(crate) built: Built,
    /// Finest first; none where even the finest is too large to build upon.
    pub(crate) forms: Vec<Form>,
    /// Grid step that the vertices of all forms lie on, or 0 where they lie on none.
    pub(crate) step: f64,
    /// Distance that parts have been welded within.
    pub(crate) epsilon: f64,
    /// The greatest error here or below.
    pub(crate) worst: f64,
}

/// A subtree: its root, which its parent may still change, and everything below in tree order.
#[derive(Debug)]
pub(crate) struct Subtree {
    pub(crate) top: Top,
    pub(crate) below: Vec<Built>,
}

impl Top {
    pub(crate) fn encode(&self, out: &mut Encoder) {
        out.put([self.built.node, self.built.object]);
        out.put(self.built.source_triangles);
        out.put([self.built.bounds.min.to_array(), self.built.bounds.max.to_array()]);
        out.put(self.built.levels.len() as u64);
        for level in &self.built.levels {
            out.put(level.error);
            out.put(level.triangles);
            out.put(level.parts.len() as u64);
            for part in &level.parts {
                out.put(part.transform);
                match &part.geometry {
                    Geometry::Packed(packed) => {
                        out.put(u32::MAX);
                        packed.encode(out);
                    }
                    Geometry::Written { blob, longest_edge } => {
                        out.put(blob.0);
                        out.put(*longest_edge);
                    }
                }
            }
        }
        out.put(self.forms.len() as u64);
        for form in &self.forms {
            out.put(form.error);
            out.put(form.triangles as u64);
            match &form.shape {
                Shape::Mesh(mesh) => {
                    out.put(0u8);
                    encode_mesh(mesh, out);
                }
                Shape::Parts(shared) => {
                    out.put(1u8);
                    out.put_slice(shared);
                }
            }
        }
        out.put([self.step, self.epsilon, self.worst]);
    }

    pub(crate) fn decode(from: &mut Decoder<'_>) -> Result<Self, Torn> {
        let [node, object] = from.take::<[u32; 2]>()?;
        let source_triangles = from.take()?;
        let [min, max]: [[f64; 3]; 2] = from.take()?;
        let mut levels = Vec::new();
        for _ in 0..from.take_count()? {
            let (error, triangles) = (from.take()?, from.take()?);
            let mut parts = Vec::new();
            for _ in 0..from.take_count()? {
                let transform = from.take()?;
                let geometry = match from.take::<u32>()? {
                    u32::MAX => Geometry::Packed(Packed::decode(from)?),
                    blob => Geometry::Written { blob: BlobId(blob), longest_edge: from.take()? },
                };
                parts.push(PendingPart { geometry, transform });
            }
            levels.push(PendingLevel { error, triangles, parts });
        }
        let mut forms = Vec::new();
        for _ in 0..from.take_count()? {
            let error = from.take()?;
            let triangles = from.take::<u64>()? as usize;
            let shape = match from.take::<u8>()? {
                0 => Shape::Mesh(decode_mesh(from)?),
                _ => Shape::Parts(from.take_slice()?),
            };
            forms.push(Form { error, triangles, shape });
        }
        let [step, epsilon, worst] = from.take::<[f64; 3]>()?;
        let bounds = Aabb { min: min.into(), max: max.into() };
        let built = Built { node, levels, bounds, source_triangles, object };
        Ok(Self { built, forms, step, epsilon, worst })
    }
}

fn encode_mesh(mesh: &Mesh, out: &mut Encoder) {
    out.put(mesh.vertices.len() as u64);
    for vertex in &mesh.vertices {
        out.put(vertex.position.to_array());
        out.put(vertex.normal.to_array());
        out.put(vertex.color);
        out.put(vertex.tex_coord);
        out.put(vertex.surface);
        out.put(vertex.seam);
    }
    out.put_slice(&mesh.triangles);
}

fn decode_mesh(from: &mut Decoder<'_>) -> Result<Mesh, Torn> {
    let mut mesh = Mesh::default();
    for _ in 0..from.take_count()? {
        mesh.vertices.push(MeshVertex {
            position: DVec3::from_array(from.take()?),
            normal: Vec3::from_array(from.take()?),
            color: from.take()?,
            tex_coord: from.take()?,
            surface: from.take()?,
            seam: from.take()?,
        });
    }
    mesh.triangles = from.take_slice()?;
    let count = mesh.vertices.len();
    if mesh.triangles.as_flattened().iter().all(|&v| (v as usize) < count) {
        Ok(mesh)
    } else {
        Err(Torn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pack::pack;
    use crate::source::Surface;

    #[test]
    fn tops_come_back_from_bytes() {
        let vertex = |x: f64, y: f64| MeshVertex {
            seam: 3,
            tex_coord: [0.5, 2.0],
            ..MeshVertex::plain(DVec3::new(x, y, 0.0), Vec3::Z, [1, 2, 3, 255])
        };
        let mesh = Mesh {
            vertices: vec![vertex(0.0, 0.0), vertex(2.0, 0.0), vertex(0.0, 1.0)],
            triangles: vec![[0, 1, 2]],
        };
        let packed = pack(&mesh, 1.0, &[Surface::PLAIN]).unwrap();
        let part = |geometry| PendingPart { geometry, transform: 9 };
        let top = Top {
            built: Built {
                node: 4,
                levels: vec![PendingLevel {
                    error: 0.1,
                    triangles: 2,
                    parts: vec![
                        part(Geometry::Packed(packed)),
                        part(Geometry::Written { blob: BlobId(7), longest_edge: 2.5 }),
                    ],
                }],
                bounds: mesh.bounds(),
                source_triangles: 5,
                object: 8,
            },
            forms: vec![
                Form { error: 0.1, triangles: 1, shape: Shape::Mesh(mesh) },
                Form { error: 0.2, triangles: 3, shape: Shape::Parts(vec![[1, 2]]) },
            ],
            step: 1.0,
            epsilon: 0.5,
            worst: 0.25,
        };
        let mut out = Encoder::default();
        top.encode(&mut out);
        assert_eq!(Top::decode(&mut Decoder(&out.0)).as_ref(), Ok(&top));
        assert!((0..out.0.len()).all(|end| Top::decode(&mut Decoder(&out.0[..end])).is_err()));
    }
}
