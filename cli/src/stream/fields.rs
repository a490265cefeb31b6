//! Fields `name=value` of the module's answers, such as that to `status`.

/// Returns the value of a field `name=value` in an answer.
pub fn field<'a>(answer: &'a str, name: &str) -> Option<&'a str> {
    let fields = answer.split(' ');
    let mut values = fields.filter_map(|field| field.split_once('='));
    values.find_map(|(key, value)| (key == name).then_some(value))
}

/// Returns the numbers of a field `name=1,2,3`; none if the field is missing.
pub fn numbers(answer: &str, name: &str) -> Vec<f64> {
    let values = field(answer, name)
        .into_iter()
        .flat_map(|text| text.split(','));
    values.filter_map(|number| number.parse().ok()).collect()
}
