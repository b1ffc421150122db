//! Small scene files, built by hand for the tests beside the code.

use std::io::Cursor;
use std::path::Path;

use serde_json::{Value, json};

use super::import_store;
use crate::import::store::Store;
use crate::import::testing::{collect, collect_within};
use crate::import::{ImportError, ImportLimits};
use crate::source::Source;

/// What a file of these bytes holds, for tests that need no file.
pub(super) fn import_bytes(file: &Path, bytes: &[u8]) -> Result<Source, ImportError> {
    let store = Store::memory(bytes.to_vec());
    collect(&file.to_string_lossy(), |out| import_store(file, store, out))
}

/// Component types as files spell them.
pub(super) const U8: u32 = 5121;
pub(super) const U16: u32 = 5123;
pub(super) const U32: u32 = 5125;
pub(super) const F32: u32 = 5126;

/// A GLB of one JSON and one binary chunk.
pub(super) fn glb(json: &str, bin: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bin = bin.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((28 + json.len() as u32 + bin.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &bin)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

/// An RGBA PNG.
pub(super) fn png(width: u32, height: u32, texels: &[[u8; 4]]) -> Vec<u8> {
    let picture = image::RgbaImage::from_raw(width, height, texels.concat()).unwrap();
    let mut out = Cursor::new(Vec::new());
    picture.write_to(&mut out, image::ImageFormat::Png).unwrap();
    out.into_inner()
}

/// A scene under construction; `json` may be edited at will before it is imported.
pub(super) struct Scene {
    pub(super) json: Value,
    pub(super) bin: Vec<u8>,
}

impl Scene {
    /// No meshes and no nodes.
    pub(super) fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"}, "buffers": [{"byteLength": 0}], "bufferViews": [], "accessors": [],
            "meshes": [], "nodes": [], "materials": [], "textures": [], "images": [],
        });
        Self { json, bin: Vec::new() }
    }

    /// One triangle in the plane z = 0, indexed by u16, shown by one node.
    pub(super) fn triangle() -> Self {
        let mut scene = Self::new();
        let positions = scene.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let indices = scene.accessor(U16, "SCALAR", 3, &[0, 0, 1, 0, 2, 0]);
        scene.add(
            "meshes",
            json!({"primitives": [{"attributes": {"POSITION": positions}, "indices": indices}]}),
        );
        scene.add("nodes", json!({"mesh": 0}));
        scene
    }

    /// Appends to one of the document's lists; the new number.
    pub(super) fn add(&mut self, list: &str, item: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(item);
        list.len() - 1
    }

    pub(super) fn view(&mut self, bytes: &[u8]) -> usize {
        let start = self.bin.len().next_multiple_of(4);
        self.bin.resize(start, 0);
        self.bin.extend(bytes);
        self.add(
            "bufferViews",
            json!({"buffer": 0, "byteOffset": start, "byteLength": bytes.len()}),
        )
    }

    pub(super) fn accessor(
        &mut self,
        component: u32,
        element: &str,
        count: usize,
        bytes: &[u8],
    ) -> usize {
        let view = self.view(bytes);
        self.add("accessors", json!({"bufferView": view, "componentType": component, "type": element, "count": count}))
    }

    pub(super) fn floats(&mut self, element: &str, values: &[f32]) -> usize {
        let lanes = if element == "SCALAR" { 1 } else { usize::from(element.as_bytes()[3] - b'0') };
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor(F32, element, values.len() / lanes, &bytes)
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if let Some(first) = json["buffers"].get_mut(0).filter(|first| first["byteLength"] == 0) {
            first["byteLength"] = self.bin.len().into();
        }
        glb(&json.to_string(), &self.bin)
    }

    pub(super) fn import(&self) -> Result<Source, ImportError> {
        import_bytes(Path::new("scene.glb"), &self.bytes())
    }

    /// The same within other limits.
    pub(super) fn import_within(&self, limits: ImportLimits) -> Result<Source, ImportError> {
        let file = Path::new("scene.glb");
        let store = Store::memory(self.bytes());
        collect_within("scene.glb", limits, |out| import_store(file, store, out))
    }

    /// The message of the error this scene must give; it names the file.
    pub(super) fn error(&self) -> String {
        let message = self.import().expect_err("a broken scene must be refused").to_string();
        assert!(message.starts_with("scene.glb: "), "{message}");
        message
    }
}
