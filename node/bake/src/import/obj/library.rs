//! Materials of MTL files (Wavefront, *MTL material format*): diffuse colour, its picture, dissolve. Keywords may be
//! written in any case.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use super::map::Map;
use super::names::{self, libraries, locate, may_join, statement};
use crate::import::builder::Paint;
use crate::import::emit::Emitter;
use crate::import::error::ImportError;
use crate::import::open::open;
use crate::import::picture::linear_of;
use crate::import::text::{Lines, data, excerpt, number};
use crate::import::texture::{self, Had};
use crate::source::{Alpha, Surface, Wrap};

/// A material in use.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Material {
    /// Colour and surface.
    pub(super) paint: Paint,
    /// Mean of its picture in linear light; white without one.
    mean: [f64; 3],
    /// Scale and offset of texture coordinates.
    lookup: [[f64; 2]; 2],
}

impl Material {
    /// For faces without a material.
    const PLAIN: Self = Self { paint: Paint::PLAIN, mean: [1.0; 3], lookup: [[1.0; 2], [0.0; 2]] };

    /// The paint of faces without texture coordinates.
    pub(super) fn unmapped(&self) -> Paint {
        let mut paint = self.paint;
        paint.surface.texture = None;
        paint.color.iter_mut().zip(self.mean).for_each(|(lane, mean)| *lane *= mean);
        paint
    }

    /// Where the picture is looked up, from its top left corner, for a coordinate from its bottom
    /// left one.
    pub(super) fn looked_up(&self, coord: [f32; 2]) -> [f32; 2] {
        let [scale, offset] = self.lookup;
        let [u, v] = [0, 1].map(|lane| f64::from(coord[lane]) * scale[lane] + offset[lane]);
        [u as f32, (1.0 - v) as f32]
    }
}

/// A material as its file has it.
#[derive(Clone, Debug, PartialEq)]
struct Definition {
    /// sRGB-encoded.
    diffuse: Option<[f64; 3]>,
    dissolve: Option<f64>,
    /// What some write instead, and some beside it with another meaning.
    transparency: Option<f64>,
    map: Option<Map>,
    /// Its library.
    file: PathBuf,
}

impl Definition {
    /// 1 where it hides all behind it. What says how solid it is goes before what says how transparent.
    fn alpha(&self) -> f64 {
        let transparent = self.transparency.unwrap_or(0.0);
        self.dissolve.unwrap_or(1.0 - transparent).clamp(0.0, 1.0)
    }
}

/// All materials a scene names.
pub(super) struct Library<'a> {
    scene: &'a Path,
    definitions: BTreeMap<String, Definition>,
    /// Those in use; the first is for faces without one.
    materials: Vec<Material>,
    numbers: BTreeMap<String, usize>,
    /// Libraries that were read.
    files: BTreeSet<PathBuf>,
    /// Pictures by file and wrap mode; `None` where one cannot be had.
    pictures: BTreeMap<(PathBuf, bool), Option<Had>>,
    /// Transparency pictures, which are not read.
    masks: u64,
    /// Values that are no numbers.
    ignored: u64,
    /// What was skipped, one sentence each.
    pub(super) notes: Vec<String>,
}

impl<'a> Library<'a> {
    /// Without materials; `scene` is the file that will name some.
    pub(super) fn new(scene: &'a Path) -> Self {
        Self {
            scene,
            definitions: BTreeMap::new(),
            materials: vec![Material::PLAIN],
            numbers: BTreeMap::new(),
            files: BTreeSet::new(),
            pictures: BTreeMap::new(),
            masks: 0,
            ignored: 0,
            notes: Vec::new(),
        }
    }

    /// A material in use.
    pub(super) fn material(&self, number: usize) -> &Material {
        &self.materials[number]
    }

    /// The number of the material of this name, whose texture goes to `out` at its first use.
    pub(super) fn used(&mut self, name: &str, out: &mut Emitter<'_>) -> Result<usize, ImportError> {
        if let Some(&number) = self.numbers.get(name) {
            return Ok(number);
        }
        let number = match self.definitions.get(name).cloned() {
            Some(definition) => {
                let material = self.make(name, &definition, out)?;
                self.materials.push(material);
                self.materials.len() - 1
            }
            None => {
                if !name.is_empty() {
                    self.notes.push(format!("material {name:?} is not defined, white is used"));
                }
                0
            }
        };
        self.numbers.insert(name.to_owned(), number);
        Ok(number)
    }

    fn make(
        &mut self,
        name: &str,
        definition: &Definition,
        out: &mut Emitter<'_>,
    ) -> Result<Material, ImportError> {
        let mut material = Material::PLAIN;
        let mut diffuse =
            definition.diffuse.unwrap_or([1.0; 3]).map(|v| linear_of(v.clamp(0.0, 1.0)));
        if let Some(map) = &definition.map {
            match self.picture(name, definition, map, out)? {
                None => {}
                Some(had) => {
                    // Some exporters write black beside a picture, where they mean the picture.
                    if diffuse == [0.0; 3] {
                        diffuse = [1.0; 3];
                    }
                    match had {
                        Had::Plain(color) => {
                            diffuse.iter_mut().zip(color).for_each(|(lane, plain)| *lane *= plain);
                        }
                        Had::Texture { number, mean } => {
                            material.paint.surface.texture = Some(number);
                            material.mean = mean;
                            material.lookup = [map.scale.unwrap_or([1.0; 2]), map.offset];
                        }
                    }
                }
            }
        }
        let alpha = definition.alpha();
        let [r, g, b] = diffuse;
        material.paint.color = [r, g, b, alpha];
        let mode = if alpha < 1.0 { Alpha::Blend } else { Alpha::Opaque };
        material.paint.surface = Surface { alpha: mode, ..material.paint.surface };
        Ok(material)
    }

    fn picture(
        &mut self,
        material: &str,
        definition: &Definition,
        map: &Map,
        out: &mut Emitter<'_>,
    ) -> Result<Option<Had>, ImportError> {
        let at = format!("material {material:?}");
        let path = match locate(self.scene, &definition.file, &at, &map.file) {
            Ok(path) => path,
            Err(ImportError::MissingResource { .. } | ImportError::OutsideFolder { .. }) => {
                let why = format!("{:?} is missing in the scene's folder", map.file);
                self.notes.push(format!("{at}: {why}, its colour alone is used"));
                return Ok(None);
            }
            Err(error) => return Err(error),
        };
        let key = (path, map.clamps);
        if let Some(&known) = self.pictures.get(&key) {
            return Ok(known);
        }
        let wrap = [if map.clamps { Wrap::Clamp } else { Wrap::Repeat }; 2];
        let had = match texture::read(&key.0, &map.file, wrap, out)? {
            Ok(had) => Some(had),
            Err(why) => {
                let why = format!("{:?} cannot be decoded ({why})", map.file);
                self.notes.push(format!("{at}: {why}, its colour alone is used"));
                None
            }
        };
        self.pictures.insert(key, had);
        Ok(had)
    }

    /// Reads the libraries of a line, each once; one that is not there leaves a note.
    pub(super) fn read(&mut self, at: u64, names: &str) -> Result<(), ImportError> {
        for (name, path) in libraries(self.scene, &format!("line {at}"), names) {
            match path {
                Ok(path) if self.files.insert(path.clone()) => {
                    let unreadable = |source| ImportError::Read { file: path.clone(), source };
                    let file = open(&path).map_err(unreadable)?;
                    self.parse(&path, BufReader::new(file))?;
                    // What was asked for too early may be defined by now.
                    self.numbers.retain(|_, number| *number != 0);
                }
                Ok(_) => {}
                Err(ImportError::MissingResource { .. } | ImportError::OutsideFolder { .. }) => {
                    let name = excerpt(name.as_bytes());
                    self.notes.push(format!(
                        "{name:?} is missing in the scene's folder, its materials are white"
                    ));
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// What was found, and what was left out.
    pub(super) fn into_notes(self) -> Vec<String> {
        let mut notes = self.notes;
        for (count, what) in [
            (self.masks, "transparency pictures (map_d) ignored"),
            (self.ignored, "transparencies of materials that are no numbers ignored"),
        ] {
            if count > 0 {
                notes.push(format!("{count} {what}"));
            }
        }
        notes
    }

    fn parse(&mut self, file: &Path, reader: impl BufRead) -> Result<(), ImportError> {
        let mut lines = Lines::new(reader);
        let mut present: Option<&mut Definition> = None;
        while let Some((_, line)) = lines.next(may_join).map_err(|error| error.of(file))? {
            let Some((word, rest)) = statement(line) else { continue };
            if word == b"newmtl" {
                let empty = Definition {
                    diffuse: None,
                    dissolve: None,
                    transparency: None,
                    map: None,
                    file: file.into(),
                };
                let entry = self.definitions.entry(names::name(rest)).or_insert(empty.clone());
                *entry = empty;
                present = Some(entry);
                continue;
            }
            let Some(material) = present.as_deref_mut() else { continue };
            match &word[..] {
                b"kd" => {
                    let lanes: Vec<f64> = data(rest).map_while(number).take(3).collect();
                    match lanes[..] {
                        [r, g, b] => material.diffuse = Some([r, g, b]),
                        // One number stands for all three; spectral curves and XYZ give none.
                        [grey] => material.diffuse = Some([grey; 3]),
                        _ => {}
                    }
                }
                b"d" | b"tr" => {
                    let value = data(rest).find(|word| *word != b"-halo").and_then(number);
                    self.ignored += u64::from(value.is_none());
                    let slot = match &word[..] {
                        b"d" => &mut material.dissolve,
                        _ => &mut material.transparency,
                    };
                    *slot = value.or(*slot);
                }
                b"map_kd" => material.map = Map::of(&names::name(rest)),
                b"map_d" => self.masks += 1,
                _ => {}
            }
        }
        Ok(())
    }
}
