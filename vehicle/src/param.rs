//! One parameter table per component: the struct, its defaults, TOML keys, MAVLink parameters, range checks and docs
//! from a single declaration beside the code that uses it.
//!
//! Floats are f32-exact from the start, because MAVLink carries f32: what is set is what is read back.
//!
//! ```
//! vehicle::param_choice! {
//!     /// What to do when the ground falls silent.
//!     pub enum LossAction {
//!         /// Stay.
//!         Hold = 1, "hold";
//!         /// Come down.
//!         Land = 3, "land";
//!     }
//! }
//! vehicle::params! {
//!     /// Obstacle avoidance.
//!     pub struct AvoidParams {
//!         /// Certainty above which a sector is blocked (Borenstein 1991).
//!         threshold: float "VFH_THRESH" = 0.35, "1", 0.0..=1.0;
//!         /// Sectors around the vehicle.
//!         sectors: int "VFH_SECTORS" = 72, "1", 36..=144;
//!         /// Avoid obstacles at all.
//!         enabled: bool "VFH_ENABLE" = true;
//!         /// What to do when the ground falls silent.
//!         on_loss: choice<LossAction> "NAV_DLL_ACT" = LossAction::Land;
//!     }
//! }
//! use vehicle::{ParamSet, ParamValue};
//! let mut p = AvoidParams::default();
//! p.set_by_id("VFH_THRESH", ParamValue::Float(0.5)).unwrap();
//! assert_eq!(p.threshold, 0.5);
//! let refusal = p.set_by_id("VFH_THRESH", ParamValue::Float(2.0)).unwrap_err();
//! assert_eq!(refusal.to_string(), "VFH_THRESH = 2 is outside 0..=1");
//! ```

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Longest MAVLink parameter name, bytes.
pub const MAX_ID_LEN: usize = 16;

/// A value as MAVLink carries it; bool and choices are integers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ParamValue {
    /// MAV_PARAM_TYPE_REAL32.
    Float(f32),
    /// MAV_PARAM_TYPE_INT32.
    Int(i32),
}

impl std::fmt::Display for ParamValue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Float(v) => write!(f, "{v}"),
            Self::Int(v) => write!(f, "{v}"),
        }
    }
}

/// What a parameter may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ParamKind {
    /// A number.
    Float {
        /// Default.
        default: f32,
        /// Smallest allowed.
        min: f32,
        /// Largest allowed.
        max: f32,
    },
    /// A whole number.
    Int {
        /// Default.
        default: i32,
        /// Smallest allowed.
        min: i32,
        /// Largest allowed.
        max: i32,
    },
    /// Off 0 or on 1.
    Bool {
        /// Default.
        default: bool,
    },
    /// One of a list.
    Choice {
        /// Default.
        default: i32,
        /// Name and code of each.
        names: &'static [(&'static str, i32)],
    },
}

/// One row of a parameter table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParamMeta {
    /// MAVLink name, at most 16 bytes.
    pub id: &'static str,
    /// TOML key inside the component's table.
    pub key: &'static str,
    /// What it does, for people.
    pub doc: &'static str,
    /// Unit, `1` if none.
    pub unit: &'static str,
    /// Kind, default and range.
    pub kind: ParamKind,
}

impl ParamMeta {
    /// Default as MAVLink carries it.
    #[must_use]
    pub fn default_value(&self) -> ParamValue {
        match self.kind {
            ParamKind::Float { default, .. } => ParamValue::Float(default),
            ParamKind::Int { default, .. } | ParamKind::Choice { default, .. } => {
                ParamValue::Int(default)
            }
            ParamKind::Bool { default } => ParamValue::Int(i32::from(default)),
        }
    }

    /// The value in this parameter's own type, within range. A whole-number float is accepted for an integer and the
    /// other way round: ground scripts send REAL32 for everything.
    ///
    /// # Errors
    /// Says id, value and what is allowed.
    pub fn check(&self, value: ParamValue) -> Result<ParamValue, ParamError> {
        let outside = |allowed: String| ParamError::Outside {
            id: self.id,
            got: value.to_string(),
            allowed,
        };
        match self.kind {
            ParamKind::Float { min, max, .. } => {
                let v = match value {
                    ParamValue::Float(v) => v,
                    ParamValue::Int(v) => v as f32,
                };
                if v >= min && v <= max {
                    Ok(ParamValue::Float(v))
                } else {
                    Err(outside(format!("{min}..={max}")))
                }
            }
            ParamKind::Int { min, max, .. } => match whole(value) {
                Some(v) if (min..=max).contains(&v) => Ok(ParamValue::Int(v)),
                _ => Err(outside(format!("{min}..={max}"))),
            },
            ParamKind::Bool { .. } => match whole(value) {
                Some(v @ 0..=1) => Ok(ParamValue::Int(v)),
                _ => Err(outside("0 (off) or 1 (on)".to_owned())),
            },
            ParamKind::Choice { names, .. } => match whole(value) {
                Some(v) if names.iter().any(|(_, code)| *code == v) => Ok(ParamValue::Int(v)),
                _ => {
                    let list: Vec<String> = names
                        .iter()
                        .map(|(name, code)| format!("{code} ({name})"))
                        .collect();
                    Err(outside(list.join(", ")))
                }
            },
        }
    }
}

fn whole(value: ParamValue) -> Option<i32> {
    match value {
        ParamValue::Int(v) => Some(v),
        ParamValue::Float(v) if v.is_finite() && v.abs() < 2.0e9 => Some(libm::roundf(v) as i32),
        ParamValue::Float(_) => None,
    }
}

/// Why a parameter was not set.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ParamError {
    /// No such name or index.
    #[error("no parameter named {0}")]
    Unknown(String),
    /// Out of range.
    #[error("{id} = {got} is outside {allowed}")]
    Outside {
        /// Parameter.
        id: &'static str,
        /// Value asked for.
        got: String,
        /// Values allowed.
        allowed: String,
    },
}

/// A component's parameters, by index in declaration order.
pub trait ParamSet {
    /// The table.
    fn meta(&self) -> &'static [ParamMeta];
    /// The value at an index of the table.
    fn get(&self, index: usize) -> Option<ParamValue>;
    /// Sets the value at an index, checked.
    ///
    /// # Errors
    /// [`ParamError`]; the old value stays.
    fn set(&mut self, index: usize, value: ParamValue) -> Result<(), ParamError>;

    /// The value of a MAVLink name.
    fn get_by_id(&self, id: &str) -> Option<ParamValue> {
        self.get(self.meta().iter().position(|m| m.id == id)?)
    }

    /// Sets by MAVLink name, checked.
    ///
    /// # Errors
    /// [`ParamError`]; the old value stays.
    fn set_by_id(&mut self, id: &str, value: ParamValue) -> Result<(), ParamError> {
        match self.meta().iter().position(|m| m.id == id) {
            Some(index) => self.set(index, value),
            None => Err(ParamError::Unknown(id.to_owned())),
        }
    }
}

/// An enumeration that can be a parameter; declared by [`param_choice!`](crate::param_choice).
pub trait ParamChoice: Copy {
    /// Name and code of each variant.
    const NAMES: &'static [(&'static str, i32)];
    /// Code of this variant.
    fn code(self) -> i32;
    /// Variant of a code.
    fn from_code(code: i32) -> Option<Self>;
}

/// Declares an enumeration that can be a parameter. See [`param`](crate::param).
#[macro_export]
macro_rules! param_choice {
    ($(#[$attr:meta])* pub enum $name:ident { $($(#[$vattr:meta])* $variant:ident = $code:literal, $label:literal;)+ }) => {
        $(#[$attr])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name { $($(#[$vattr])* $variant = $code),+ }
        impl $crate::param::ParamChoice for $name {
            const NAMES: &'static [(&'static str, i32)] = &[$(($label, $code)),+];
            fn code(self) -> i32 { self as i32 }
            fn from_code(code: i32) -> Option<Self> {
                match code { $($code => Some(Self::$variant),)+ _ => None }
            }
        }
    };
}

/// Declares a component's parameter table. See [`param`](crate::param).
#[macro_export]
macro_rules! params {
    (
        $(#[$attr:meta])* pub struct $name:ident {
            $($(#[doc = $doc:literal])+ $field:ident : $kind:ident $(<$choice:ty>)? $id:literal = $default:expr
              $(, $unit:literal, $min:literal ..= $max:literal)? ;)+
        }
    ) => {
        $(#[$attr])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name { $($(#[doc = $doc])+ pub $field: $crate::params!(@type $kind $(<$choice>)?)),+ }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $crate::params!(@default $kind $default)),+ }
            }
        }

        impl $name {
            /// The parameter table.
            pub const META: &'static [$crate::ParamMeta] = &[
                $($crate::ParamMeta {
                    id: {
                        const { assert!($id.len() <= $crate::param::MAX_ID_LEN, "MAVLink names have at most 16 bytes") };
                        $id
                    },
                    key: stringify!($field),
                    doc: concat!($($doc),+),
                    unit: $crate::params!(@unit $($unit)?),
                    kind: $crate::params!(@kind $kind $(<$choice>)? $default $(, $min, $max)?),
                }),+
            ];
        }

        impl $crate::ParamSet for $name {
            fn meta(&self) -> &'static [$crate::ParamMeta] { Self::META }

            fn get(&self, index: usize) -> Option<$crate::ParamValue> {
                let mut at = 0usize;
                $(if index == at { return Some($crate::params!(@get $kind self.$field)); } at += 1;)+
                let _ = at;
                None
            }

            fn set(&mut self, index: usize, value: $crate::ParamValue) -> Result<(), $crate::ParamError> {
                let meta = Self::META.get(index).ok_or_else(|| $crate::ParamError::Unknown(index.to_string()))?;
                let value = meta.check(value)?;
                let mut at = 0usize;
                $(if index == at { $crate::params!(@set $kind $(<$choice>)? self.$field, value); return Ok(()); } at += 1;)+
                let _ = at;
                Ok(())
            }
        }
    };

    (@type float) => { f64 };
    (@type int) => { i32 };
    (@type bool) => { bool };
    (@type choice <$choice:ty>) => { $choice };
    // Through f32, so that the default is what MAVLink reads back.
    (@default float $default:expr) => { f64::from($default as f32) };
    (@default $kind:ident $default:expr) => { $default };
    (@unit) => { "1" };
    (@unit $unit:literal) => { $unit };
    (@kind float $default:expr, $min:literal, $max:literal) => {
        $crate::param::ParamKind::Float {
            default: { const { assert!($default as f32 >= $min as f32 && $default as f32 <= $max as f32) }; $default as f32 },
            min: $min as f32, max: $max as f32,
        }
    };
    (@kind int $default:expr, $min:literal, $max:literal) => {
        $crate::param::ParamKind::Int {
            default: { const { assert!($default >= $min && $default <= $max) }; $default }, min: $min, max: $max,
        }
    };
    (@kind bool $default:expr) => { $crate::param::ParamKind::Bool { default: $default } };
    (@kind choice <$choice:ty> $default:expr) => {
        $crate::param::ParamKind::Choice {
            default: $default as i32, names: <$choice as $crate::param::ParamChoice>::NAMES,
        }
    };
    (@get float $value:expr) => { $crate::ParamValue::Float($value as f32) };
    (@get int $value:expr) => { $crate::ParamValue::Int($value) };
    (@get bool $value:expr) => { $crate::ParamValue::Int(i32::from($value)) };
    (@get choice $value:expr) => { $crate::ParamValue::Int($crate::param::ParamChoice::code($value)) };
    (@set float $place:expr, $value:expr) => {
        if let $crate::ParamValue::Float(v) = $value { $place = f64::from(v); }
    };
    (@set int $place:expr, $value:expr) => { if let $crate::ParamValue::Int(v) = $value { $place = v; } };
    (@set bool $place:expr, $value:expr) => { if let $crate::ParamValue::Int(v) = $value { $place = v == 1; } };
    (@set choice <$choice:ty> $place:expr, $value:expr) => {
        if let $crate::ParamValue::Int(v) = $value {
            if let Some(c) = <$choice as $crate::param::ParamChoice>::from_code(v) { $place = c; }
        }
    };
}

#[cfg(test)]
#[expect(unreachable_pub, reason = "the macros declare public items")]
mod tests {
    use super::*;

    param_choice! {
        /// Test choice.
        pub enum Fruit {
            /// Red.
            Apple = 1, "apple";
            /// Yellow.
            Pear = 4, "pear";
        }
    }
    params! {
        /// Test table.
        pub struct Basket {
            /// Weight.
            weight: float "T_WEIGHT" = 0.35, "kg", 0.0..=2.0;
            /// Number.
            count: int "T_COUNT" = 3, "1", 0..=9;
            /// Covered.
            covered: bool "T_COVER" = false;
            /// What is in it.
            fruit: choice<Fruit> "T_FRUIT" = Fruit::Pear;
        }
    }

    #[test]
    fn what_is_set_is_what_is_read_back() {
        let mut b = Basket::default();
        assert_eq!(b.get_by_id("T_WEIGHT"), Some(ParamValue::Float(0.35)));
        b.set_by_id("T_COUNT", ParamValue::Float(5.0)).unwrap();
        b.set_by_id("T_COVER", ParamValue::Int(1)).unwrap();
        b.set_by_id("T_FRUIT", ParamValue::Int(1)).unwrap();
        assert_eq!((b.count, b.covered, b.fruit), (5, true, Fruit::Apple));
    }

    #[test]
    fn wrong_values_are_refused_with_the_allowed_ones_and_change_nothing() {
        let mut b = Basket::default();
        let said = |e: Result<(), ParamError>| e.unwrap_err().to_string();
        assert_eq!(
            said(b.set_by_id("T_WEIGHT", ParamValue::Float(f32::NAN))),
            "T_WEIGHT = NaN is outside 0..=2"
        );
        assert_eq!(
            said(b.set_by_id("T_FRUIT", ParamValue::Int(2))),
            "T_FRUIT = 2 is outside 1 (apple), 4 (pear)"
        );
        assert_eq!(
            said(b.set_by_id("T_X", ParamValue::Int(2))),
            "no parameter named T_X"
        );
        assert_eq!(b, Basket::default());
    }
}
