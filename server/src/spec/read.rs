//! Small readers: a value or its default, with the field's path in every error.

use photoneye_eye::experiment::RangeError;
use photoneye_eye::plan::PlanError;
use photoneye_proto::FieldError;

/// An error of the model, in the schema's words.
pub fn field_error(error: RangeError) -> FieldError {
    FieldError::new(error.field, format!("{} is out of range, allowed is {}", error.value, error.allowed))
}

/// What the planner refuses; what the optics refuse is the eye's.
pub fn plan_error(error: PlanError) -> FieldError {
    match error {
        PlanError::Range(error) => field_error(error),
        PlanError::Model(message) => FieldError::new("eye", message),
    }
}

/// The number or its default; -0 is 0.
pub fn number(value: Option<f64>, default: f64) -> f64 {
    value.unwrap_or(default) + 0.0
}

/// The value, which must be there.
pub fn needed<T>(path: &str, value: Option<T>) -> Result<T, FieldError> {
    value.ok_or_else(|| FieldError::new(path, "is missing"))
}

/// Checks a number on its way into the experiment.
pub fn in_range(path: &str, value: f64, min: f64, max: f64) -> Result<f64, FieldError> {
    photoneye_eye::experiment::check_range(path, value, min, max).map_err(field_error)?;
    Ok(value)
}

/// The choice of an enum or its default. Over gRPC any number may come.
pub fn choice<E: TryFrom<i32> + Copy>(
    path: &str,
    value: Option<i32>,
    default: E,
    name: fn(&E) -> &'static str,
) -> Result<E, FieldError> {
    let Some(value) = value else {
        return Ok(default);
    };
    E::try_from(value).map_err(|_| {
        let all = (0..).map_while(|i| E::try_from(i).ok());
        let names: Vec<String> = all.map(|choice| format!("`{}`", name(&choice))).collect();
        FieldError::new(path, format!("unknown variant `{value}`, expected one of {}", names.join(", ")))
    })
}

/// A message whose oneof holds nothing.
pub fn empty_choice(path: &str, names: &[&str]) -> FieldError {
    let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    FieldError::new(path, format!("is empty, expected one of {}", names.join(", ")))
}

/// Exactly so many numbers.
pub fn numbers<const N: usize>(path: &str, values: &[f64]) -> Result<[f64; N], FieldError> {
    let array: Option<[f64; N]> = values.try_into().ok();
    let array =
        array.ok_or_else(|| FieldError::new(path, format!("{} values, expected {N}", values.len())))?;
    Ok(array.map(|value| value + 0.0))
}
