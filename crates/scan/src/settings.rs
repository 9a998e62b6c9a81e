//! `--set table.key=value` over a settings struct.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// A setting that can't be made.
#[derive(Debug, thiserror::Error)]
pub enum SettingError {
    /// There is no `=`.
    #[error("--set {setting}: expected KEY=VALUE, e.g. key_frames=15")]
    Form {
        /// What was given.
        setting: String,
    },
    /// No setting has this name.
    #[error("--set {setting}: there is no `{name}`; did you mean `{nearest}`? There are {known}")]
    Unknown {
        /// What was given.
        setting: String,
        /// The name.
        name: String,
        /// The most similar name.
        nearest: String,
        /// All names at this place.
        known: String,
    },
    /// The value doesn't fit.
    #[error("--set {setting}: {message}")]
    Value {
        /// What was given.
        setting: String,
        /// What the parser says.
        message: String,
    },
}

/// `base` with the settings laid over it; keys may be nested with dots, values are TOML or plain text.
///
/// # Errors
/// See [`SettingError`].
pub fn overlay<T: Serialize + DeserializeOwned>(base: &T, settings: &[String]) -> Result<T, SettingError> {
    let wrong = |setting: &str, message: &str| SettingError::Value { setting: setting.into(), message: message.into() };
    let mut table = toml::Table::try_from(base).map_err(|e| wrong("", &e.to_string()))?;
    for setting in settings {
        let (path, value) = setting.split_once('=').ok_or_else(|| SettingError::Form { setting: setting.clone() })?;
        insert(&mut table, path.trim(), parse(value.trim()), setting)?;
        // One by one, so that the message names the setting that doesn't fit.
        table.clone().try_into::<T>().map_err(|e| wrong(setting, e.message()))?;
    }
    table.try_into().map_err(|e: toml::de::Error| wrong("", e.message()))
}

fn parse(value: &str) -> toml::Value {
    let parsed: Result<toml::Table, _> = toml::from_str(&format!("value = {value}"));
    parsed.ok().and_then(|mut t| t.remove("value")).unwrap_or_else(|| toml::Value::String(value.into()))
}

fn insert(table: &mut toml::Table, path: &str, value: toml::Value, setting: &str) -> Result<(), SettingError> {
    let (head, rest) = path.split_once('.').map_or((path, None), |(h, r)| (h, Some(r)));
    let known = table.keys().cloned().collect::<Vec<_>>();
    match (table.get_mut(head), rest) {
        (Some(toml::Value::Table(inner)), Some(rest)) => insert(inner, rest, value, setting),
        (Some(entry), None) => {
            *entry = value;
            Ok(())
        }
        _ => Err(SettingError::Unknown {
            setting: setting.into(),
            name: path.into(),
            nearest: known
                .iter()
                .max_by(|a, b| strsim::jaro(a, head).total_cmp(&strsim::jaro(b, head)))
                .cloned()
                .unwrap_or_default(),
            known: known.join(", "),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::ScanConfig;

    fn set(text: &str) -> Result<ScanConfig, SettingError> {
        overlay(&ScanConfig::default(), &[text.to_string()])
    }

    #[test]
    fn settings_reach_nested_keys_and_wrong_ones_are_named() {
        assert_eq!(set("key_frames=15").unwrap().key_frames, 15);
        assert!(!set("align.photometric.enabled = false").unwrap().align.photometric.enabled);
        assert!(matches!(set("key_frames"), Err(SettingError::Form { .. })));
        assert!(set("keyframes=3").unwrap_err().to_string().contains("did you mean `key_frames`"));
        assert!(matches!(set("key_frames=many"), Err(SettingError::Value { .. })));
        assert!(matches!(set("resolution.side=3"), Err(SettingError::Unknown { .. })));
    }
}
