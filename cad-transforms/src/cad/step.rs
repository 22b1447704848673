//! STEP assemblies: which part is placed where.
//!
//! Contract: every occurrence in the assembly becomes a part, an instance that occurs twice becomes
//! two. An occurrence without a placement is an error, not a part at the origin. Lengths are
//! brought to metres by the unit of the representation they stand in, which may differ between the
//! files an assembly was put together from.
//!
//! The structure is that of AP203, AP214 and AP242 (ISO 10303-41 product structure, ISO 10303-43
//! representations): a NEXT_ASSEMBLY_USAGE_OCCURRENCE joins two product definitions; its placement
//! is a CONTEXT_DEPENDENT_SHAPE_REPRESENTATION with a
//! REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION, whose operator is an
//! ITEM_DEFINED_TRANSFORMATION or a CARTESIAN_TRANSFORMATION_OPERATOR_3D; or it is a MAPPED_ITEM in
//! the shape of the assembly. An AXIS2_PLACEMENT_3D with a name of its own that stands in a shape
//! is given as a part too: that is how CAD programs write named coordinate systems, and the datum
//! of a mount may well be one.
//!
//! Names come from the occurrence, or where that has none, from the product; siblings of one name
//! get `#1`, `#2`.

use std::collections::{BTreeMap, BTreeSet};

use super::part21::Exchange;
use super::{Cad, Fault, MOST_PARTS, Part, numbered, step_of_path};
use crate::transform::RigidTransform;

mod fields;
mod placement;
mod units;

use self::fields::Fields;

/// Deepest assembly within an assembly.
const DEEPEST: usize = 256;

/// Parts of a STEP file.
///
/// # Errors
/// What is wrong, with line and entity.
pub fn parts(bytes: &[u8]) -> Result<Cad, Vec<Fault>> {
    let exchange = Exchange::index(bytes).map_err(|fault| vec![fault])?;
    Model::of(&exchange)
        .and_then(|model| model.parts())
        .map_err(|fault| vec![fault])
}

/// A product definition, or a shape that is placed without being one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Node {
    Product(u64),
    Shape(u64),
}

/// One occurrence under its parent.
struct Child {
    name: String,
    node: Node,
    parent_from_child: RigidTransform,
    place: String,
}

struct Model<'e, 'b> {
    exchange: &'e Exchange<'b>,
    /// Names of product definitions.
    names: BTreeMap<u64, String>,
    /// Shapes of each product definition.
    shapes: BTreeMap<u64, Vec<u64>>,
    /// For each shape, one that stands for all that are the same without a transformation.
    same: BTreeMap<u64, u64>,
    /// Occurrences by the product definition that holds them.
    occurrences: BTreeMap<u64, Vec<Occurrence>>,
    /// Placements of occurrences: the relationship with transformation.
    placed_by: BTreeMap<u64, u64>,
    /// Axes that serve as the ends of a transformation.
    ends: BTreeSet<u64>,
    units: units::Units<'e, 'b>,
}

struct Occurrence {
    id: u64,
    name: String,
    related: u64,
    place: String,
}

impl<'e, 'b> Model<'e, 'b> {
    fn of(exchange: &'e Exchange<'b>) -> Result<Self, Fault> {
        let mut model = Self {
            exchange,
            names: BTreeMap::new(),
            shapes: BTreeMap::new(),
            same: BTreeMap::new(),
            occurrences: BTreeMap::new(),
            placed_by: BTreeMap::new(),
            ends: BTreeSet::new(),
            units: units::Units::new(exchange),
        };
        for kind in [
            "PRODUCT_DEFINITION",
            "PRODUCT_DEFINITION_WITH_ASSOCIATED_DOCUMENTS",
        ] {
            for &id in exchange.named(kind) {
                let name = model.product_name(id, kind)?;
                model.names.insert(id, name);
            }
        }
        if model.names.is_empty() {
            let message = "no PRODUCT_DEFINITION: the file holds no parts (geometry alone?)";
            return Err(Fault::at_line(1, message));
        }
        model.read_shapes()?;
        model.read_occurrences()?;
        Ok(model)
    }

    fn product_name(&self, id: u64, kind: &str) -> Result<String, Fault> {
        let definition = Fields::of(self.exchange, id, kind)?;
        let formation = definition.reference(2)?;
        let formation = self.exchange.instance(formation)?;
        let record = formation
            .records
            .iter()
            .find(|r| r.name.starts_with("PRODUCT_DEFINITION_FORMATION"));
        let product = match record {
            Some(record) => Fields::new(&formation, record).reference(2)?,
            None => {
                let message = "is not a PRODUCT_DEFINITION_FORMATION";
                return Err(Fault::new(formation.place(), message));
            }
        };
        let product = Fields::of(self.exchange, product, "PRODUCT")?;
        let (id_text, name) = (product.text(0)?, product.text(1)?);
        Ok([name, id_text]
            .into_iter()
            .map(|text| step_of_path(&text))
            .find(|text| !text.is_empty())
            .unwrap_or_else(|| format!("product_{id}")))
    }

    fn read_shapes(&mut self) -> Result<(), Fault> {
        for &id in self.exchange.named("SHAPE_DEFINITION_REPRESENTATION") {
            let link = Fields::of(self.exchange, id, "SHAPE_DEFINITION_REPRESENTATION")?;
            let (property, shape) = (link.reference(0)?, link.reference(1)?);
            // A property may belong to a face or to an occurrence as well.
            let property = self.exchange.instance(property)?;
            let Some(record) = property.record("PRODUCT_DEFINITION_SHAPE") else {
                continue;
            };
            let definition = Fields::new(&property, record).reference(2)?;
            if self.names.contains_key(&definition) {
                self.shapes.entry(definition).or_default().push(shape);
            }
        }
        // Shapes that are the same without a transformation, merged as in a union of sets.
        for kind in [
            "SHAPE_REPRESENTATION_RELATIONSHIP",
            "REPRESENTATION_RELATIONSHIP",
        ] {
            for &id in self.exchange.named(kind) {
                let instance = self.exchange.instance(id)?;
                if instance
                    .record("REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION")
                    .is_some()
                {
                    continue;
                }
                // Of a complex instance, the supertype holds the parameters.
                let record = instance
                    .record("REPRESENTATION_RELATIONSHIP")
                    .or_else(|| instance.record(kind));
                let Some(record) = record else { continue };
                let fields = Fields::new(&instance, record);
                let (a, b) = (
                    self.stands_for(fields.reference(2)?),
                    self.stands_for(fields.reference(3)?),
                );
                if a != b {
                    self.same.insert(a.max(b), a.min(b));
                }
            }
        }
        Ok(())
    }

    /// The one shape that stands for all that are the same.
    fn stands_for(&self, shape: u64) -> u64 {
        let mut here = shape;
        while let Some(next) = self.same.get(&here) {
            here = *next;
        }
        here
    }

    fn read_occurrences(&mut self) -> Result<(), Fault> {
        const KIND: &str = "NEXT_ASSEMBLY_USAGE_OCCURRENCE";
        for &id in self.exchange.named(KIND) {
            let fields = Fields::of(self.exchange, id, KIND)?;
            let (relating, related) = (fields.reference(3)?, fields.reference(4)?);
            let name = [fields.text(1)?, fields.text(5)?]
                .into_iter()
                .map(|text| step_of_path(&text))
                .find(|text| !text.is_empty());
            for product in [relating, related] {
                if !self.names.contains_key(&product) {
                    let message = format!("joins #{product}, which is no PRODUCT_DEFINITION");
                    return Err(Fault::new(fields.place(), message));
                }
            }
            let product = &self.names[&related];
            let occurrence = Occurrence {
                id,
                name: name.unwrap_or_else(|| product.clone()),
                related,
                place: fields.place(),
            };
            self.occurrences
                .entry(relating)
                .or_default()
                .push(occurrence);
        }
        const PLACED: &str = "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION";
        for &id in self.exchange.named(PLACED) {
            let fields = Fields::of(self.exchange, id, PLACED)?;
            let (relationship, shape) = (fields.reference(0)?, fields.reference(1)?);
            let occurrence =
                Fields::of(self.exchange, shape, "PRODUCT_DEFINITION_SHAPE")?.reference(2)?;
            if let Some(other) = self.placed_by.insert(occurrence, relationship)
                && other != relationship
            {
                let message = format!("occurrence #{occurrence} is placed twice");
                return Err(Fault::new(fields.place(), message));
            }
        }
        for &id in self.exchange.named("ITEM_DEFINED_TRANSFORMATION") {
            let fields = Fields::of(self.exchange, id, "ITEM_DEFINED_TRANSFORMATION")?;
            self.ends
                .extend([fields.reference(2)?, fields.reference(3)?]);
        }
        Ok(())
    }

    fn parts(&self) -> Result<Cad, Fault> {
        let mut notes = Vec::new();
        let mut children = BTreeMap::new();
        let mut placed = BTreeSet::new();
        // Every node's children once; instances share them.
        let mut open: Vec<Node> = self.names.keys().map(|id| Node::Product(*id)).collect();
        while let Some(node) = open.pop() {
            if children.contains_key(&node) {
                continue;
            }
            let of_node = self.children(node, &mut notes)?;
            for child in &of_node {
                placed.insert(child.node);
                open.push(child.node);
            }
            children.insert(node, of_node);
        }
        let roots: Vec<u64> = self
            .names
            .keys()
            .copied()
            .filter(|id| !placed.contains(&Node::Product(*id)))
            .collect();
        if roots.is_empty() {
            let message = "every part is part of another: the assembly is a circle";
            return Err(Fault::at_line(1, message));
        }
        if roots.len() > 1 {
            notes.push(format!(
                "{} products are part of no other; each is taken as a root with the same origin",
                roots.len()
            ));
        }
        let names = numbered(roots.iter().map(|id| self.names[id].clone()).collect());
        let mut parts = Vec::new();
        for (id, name) in roots.into_iter().zip(names) {
            let line = self.exchange.instance(id)?.place();
            let root = Child {
                name,
                node: Node::Product(id),
                parent_from_child: RigidTransform::identity(),
                place: line,
            };
            let mut way = Vec::new();
            walk(
                &children,
                &root,
                "",
                RigidTransform::identity(),
                &mut way,
                &mut parts,
            )?;
        }
        Ok(Cad { parts, notes })
    }

    fn shapes_of(&self, node: Node) -> Vec<u64> {
        match node {
            Node::Product(id) => self.shapes.get(&id).cloned().unwrap_or_default(),
            Node::Shape(id) => vec![id],
        }
    }

    /// All shapes that are one of these without a transformation, these included.
    fn alike(&self, shapes: &[u64]) -> BTreeSet<u64> {
        let stand: BTreeSet<u64> = shapes.iter().map(|shape| self.stands_for(*shape)).collect();
        let merged = self.same.keys().copied();
        let all = merged.filter(|shape| stand.contains(&self.stands_for(*shape)));
        all.chain(stand.iter().copied())
            .chain(shapes.iter().copied())
            .collect()
    }

    fn children(&self, node: Node, notes: &mut Vec<String>) -> Result<Vec<Child>, Fault> {
        let own = self.alike(&self.shapes_of(node));
        let (mut mapped, axes) = self.placed_items(&own)?;
        let mut found: Vec<Child> = Vec::new();
        let occurrences = match node {
            Node::Product(id) => self.occurrences.get(&id).map(Vec::as_slice),
            Node::Shape(_) => None,
        };
        for occurrence in occurrences.unwrap_or_default() {
            found.push(Child {
                name: occurrence.name.clone(),
                node: Node::Product(occurrence.related),
                parent_from_child: self.place(occurrence, &own, &mut mapped, notes)?,
                place: occurrence.place.clone(),
            });
        }
        found.extend(mapped.into_iter().map(|item| self.child_of_item(item)));
        found.extend(axes);
        let names = numbered(found.iter().map(|child| child.name.clone()).collect());
        for (child, name) in found.iter_mut().zip(names) {
            child.name = name;
        }
        Ok(found)
    }

    /// The mapped items of shapes, in the order of the file, and their named axes.
    fn placed_items(
        &self,
        shapes: &BTreeSet<u64>,
    ) -> Result<(Vec<placement::MappedItem>, Vec<Child>), Fault> {
        let mut mapped = Vec::new();
        let mut axes = Vec::new();
        for &shape in shapes {
            for item in self.items(shape)? {
                let instance = self.exchange.instance(item)?;
                if instance.record("MAPPED_ITEM").is_some() {
                    mapped.push(placement::mapped_item(
                        self.exchange,
                        &self.units,
                        &instance,
                        shape,
                    )?);
                } else if let Some(record) = instance.record("AXIS2_PLACEMENT_3D")
                    && !self.ends.contains(&item)
                {
                    let name = step_of_path(&Fields::new(&instance, record).text(0)?);
                    // Written by some programs in place of an empty name.
                    if !name.is_empty() && name != "NONE" {
                        let metre = self.units.metres(shape)?;
                        axes.push(Child {
                            name,
                            // No shape has the number of an axis, so it has no children.
                            node: Node::Shape(item),
                            parent_from_child: placement::axes(self.exchange, item, metre)?,
                            place: instance.place(),
                        });
                    }
                }
            }
        }
        mapped.sort_by_key(|found| found.item);
        Ok((mapped, axes))
    }

    /// `parent_from_child` of an occurrence in a parent with the shapes `own`: by its relationship,
    /// or else by the first mapped item of its shape, which is removed.
    fn place(
        &self,
        occurrence: &Occurrence,
        own: &BTreeSet<u64>,
        mapped: &mut Vec<placement::MappedItem>,
        notes: &mut Vec<String>,
    ) -> Result<RigidTransform, Fault> {
        let of_child = self.alike(&self.shapes_of(Node::Product(occurrence.related)));
        if let Some(&relationship) = self.placed_by.get(&occurrence.id) {
            return placement::relationship(
                self.exchange,
                &self.units,
                relationship,
                own,
                &of_child,
            );
        }
        let is_of_child = |item: &placement::MappedItem| of_child.contains(&item.shape);
        let Some(at) = mapped.iter().position(is_of_child) else {
            let message = format!(
                "occurrence {:?} has no placement: neither a CONTEXT_DEPENDENT_SHAPE_REPRESENTATION \
                 nor a MAPPED_ITEM belongs to it",
                occurrence.name
            );
            return Err(Fault::new(occurrence.place.clone(), message));
        };
        if mapped.iter().filter(|item| is_of_child(item)).count() > 1 {
            notes.push(format!(
                "{}: occurrences of one part are matched with its mapped items in the order of the file",
                occurrence.place
            ));
        }
        Ok(mapped.remove(at).parent_from_child)
    }

    /// The child that a mapped item without an occurrence is.
    fn child_of_item(&self, item: placement::MappedItem) -> Child {
        let owner = self
            .shapes
            .iter()
            .find(|(_, shapes)| self.alike(shapes).contains(&item.shape))
            .map(|(id, _)| *id);
        let child = owner.map_or(Node::Shape(item.shape), Node::Product);
        let product = owner.map(|id| self.names[&id].clone());
        let names = [Some(item.name), product, Some(item.shape_name)];
        let name = names.into_iter().flatten().find(|name| !name.is_empty());
        Child {
            name: name.unwrap_or_else(|| format!("shape_{}", item.shape)),
            node: child,
            parent_from_child: item.parent_from_child,
            place: item.place,
        }
    }

    /// Items of a shape representation of any kind.
    fn items(&self, shape: u64) -> Result<Vec<u64>, Fault> {
        let instance = self.exchange.instance(shape)?;
        let record = instance.record("REPRESENTATION").or_else(|| {
            instance
                .records
                .iter()
                .find(|r| r.name.ends_with("REPRESENTATION"))
        });
        match record {
            Some(record) => Fields::new(&instance, record).references(1),
            // An axis that was made a node of its own.
            None => Ok(Vec::new()),
        }
    }
}

fn walk(
    children: &BTreeMap<Node, Vec<Child>>,
    here: &Child,
    above: &str,
    root_from_parent: RigidTransform,
    way: &mut Vec<Node>,
    parts: &mut Vec<Part>,
) -> Result<(), Fault> {
    if way.contains(&here.node) {
        let message = format!("part {:?} is part of itself", here.name);
        return Err(Fault::new(here.place.clone(), message));
    }
    if parts.len() >= MOST_PARTS || way.len() >= DEEPEST {
        let message = format!("more than {MOST_PARTS} parts, or {DEEPEST} within each other");
        return Err(Fault::new(here.place.clone(), message));
    }
    let path = match above {
        "" => here.name.clone(),
        above => format!("{above}/{}", here.name),
    };
    let root_from_part = root_from_parent * here.parent_from_child;
    parts.push(Part {
        name: here.name.clone(),
        path: path.clone(),
        root_from_part,
        place: here.place.clone(),
    });
    way.push(here.node);
    for child in children
        .get(&here.node)
        .map(Vec::as_slice)
        .unwrap_or_default()
    {
        walk(children, child, &path, root_from_part, way, parts)?;
    }
    way.pop();
    Ok(())
}

#[cfg(test)]
mod tests;
