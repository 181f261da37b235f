//! The optional passphrase of the authority's key. With a passphrase, the key is in a PKCS#8 file that is encrypted with PBES2 (RFC 8018):
//! scrypt (RFC 7914) makes the key of AES-256 in CBC mode. OpenSSL reads such a file.

use std::path::{Path, PathBuf};

use pkcs8::der::zeroize::Zeroizing;
use pkcs8::pkcs5::EncryptionScheme;
use pkcs8::pkcs5::pbes2::{self, Kdf, Parameters, Salt, ScryptParams};
use pkcs8::{EncryptedPrivateKeyInfoOwned, EncryptedPrivateKeyInfoRef, LineEnding, SecretDocument};

const ENCRYPTED: &str = "ENCRYPTED PRIVATE KEY";
const PLAIN: &str = "PRIVATE KEY";

/// The cost of scrypt: OWASP recommends 2^14, 8 and 5 as equal to 2^17, 8 and 1. With the latter, scrypt needs 128 MiB, but OpenSSL
/// permits only 32 MiB.
const COST: u64 = 1 << 14;
const BLOCK_SIZE: u16 = 8;
const PARALLELIZATION: u16 = 5;

/// Maximum memory for scrypt in bytes. A damaged file could require more than the machine has.
const MEMORY_MAX: u64 = 1 << 30;
/// Maximum number of blocks that scrypt mixes one after another.
const PARALLELIZATION_MAX: u16 = 64;
/// Maximum number of iterations of PBKDF2, with which OpenSSL encrypts by default.
const ITERATIONS_MAX: u32 = 10_000_000;

/// A passphrase. Its memory is overwritten when it is no longer used.
#[derive(Clone)]
pub struct Passphrase(Zeroizing<String>);

impl Passphrase {
    /// Returns this text as a passphrase.
    ///
    /// # Errors
    /// Returns [`PassphraseError::Empty`] if the text is empty.
    pub fn new(text: String) -> Result<Self, PassphraseError> {
        let text = Zeroizing::new(text);
        if text.is_empty() { Err(PassphraseError::Empty) } else { Ok(Self(text)) }
    }

    /// Returns the first line of a file as a passphrase.
    ///
    /// # Errors
    /// Returns [`PassphraseError`] if other users can read the file, or if its first line is empty or is not UTF-8 text.
    pub fn in_file(path: &Path) -> Result<Self, PassphraseError> {
        let bytes = downbeat_key_file::read_private(path).map_err(|error| match error {
            downbeat_key_file::KeyFileError::Unreadable { path, error } => {
                PassphraseError::Unreadable { path, reason: error.to_string() }
            }
            other => PassphraseError::File(other),
        })?;
        let bytes = Zeroizing::new(bytes);
        let unreadable = || PassphraseError::Unreadable {
            path: path.into(),
            reason: "the first line is not UTF-8 text".to_owned(),
        };
        let line = bytes.split(|byte| *byte == b'\n').next().unwrap_or_default();
        let line = std::str::from_utf8(line).map_err(|_| unreadable())?;
        Self::new(line.strip_suffix('\r').unwrap_or(line).to_owned())
    }
}

impl PartialEq for Passphrase {
    fn eq(&self, other: &Self) -> bool {
        *self.0 == *other.0
    }
}

impl std::fmt::Debug for Passphrase {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Passphrase")
    }
}

/// Asks for the passphrase of the key in this file.
pub type Ask = fn(&Path) -> Result<Passphrase, PassphraseError>;

/// Why a key with a passphrase cannot be used or made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PassphraseError {
    /// Nothing states the passphrase.
    #[error("{} has a passphrase, and there is no terminal to ask for it; set DOWNBEAT_PASSPHRASE_FILE to a file with the passphrase in its first line", .0.display())]
    Unknown(PathBuf),
    /// The passphrase is not that of the key.
    #[error("wrong passphrase for {}", .0.display())]
    Wrong(PathBuf),
    /// A passphrase is empty.
    #[error("the passphrase is empty; expected at least one character")]
    Empty,
    /// A new passphrase was entered differently the second time.
    #[error("the two passphrases differ; nothing was changed")]
    Different,
    /// The file with the passphrase cannot be read.
    #[error("{}: {reason}; expected a file with the passphrase in its first line", path.display())]
    Unreadable {
        /// The path of the file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// Other users can read the file with the passphrase.
    #[error(transparent)]
    File(downbeat_key_file::KeyFileError),
    /// The terminal cannot be used.
    #[error(
        "cannot ask for a passphrase: {0}; set DOWNBEAT_PASSPHRASE_FILE to a file with the passphrase in its first line"
    )]
    Terminal(std::io::Error),
    /// The key is encrypted by a method that is not supported, or its file is damaged.
    #[error("{}: the encrypted key is damaged, or encrypted by another method; expected PBES2 with AES, as `downbeat keys passphrase` writes", .0.display())]
    Unsupported(PathBuf),
    /// The key could not be encrypted.
    #[error("cannot encrypt the key: {0}")]
    Encryption(String),
}

/// Whether a key in PEM has a passphrase.
pub(super) fn is_encrypted(pem: &str) -> bool {
    pem.contains(&format!("-----BEGIN {ENCRYPTED}-----"))
}

/// Encrypts a private key in PEM (PKCS#8).
pub(super) fn encrypt(pem: &str, passphrase: &Passphrase) -> Result<Zeroizing<String>, PassphraseError> {
    let failed = |error: &dyn std::fmt::Display| PassphraseError::Encryption(error.to_string());
    let (mut salt, mut iv) = ([0; 16], [0; 16]);
    for random in [&mut salt, &mut iv] {
        getrandom::fill(random).map_err(|error| failed(&error))?;
    }
    let (_, plain) = SecretDocument::from_pem(pem).map_err(|error| failed(&error))?;
    let kdf = Kdf::Scrypt(ScryptParams {
        salt: Salt::new(salt).map_err(|error| failed(&error))?,
        cost_parameter: COST,
        block_size: BLOCK_SIZE,
        parallelization: PARALLELIZATION,
        key_length: None,
    });
    let parameters = Parameters { kdf, encryption: pbes2::EncryptionScheme::Aes256Cbc { iv } };
    let bytes =
        parameters.encrypt(passphrase.0.as_bytes(), plain.as_bytes()).map_err(|error| failed(&error))?;
    let encrypted_data = pkcs8::der::asn1::OctetString::new(bytes).map_err(|error| failed(&error))?;
    let info = EncryptedPrivateKeyInfoOwned { encryption_algorithm: parameters.into(), encrypted_data };
    let document = SecretDocument::try_from(info).map_err(|error| failed(&error))?;
    document.to_pem(ENCRYPTED, LineEnding::LF).map_err(|error| failed(&error))
}

/// Decrypts a private key in PEM. `path` is the file of the key.
pub(super) fn decrypt(
    pem: &str,
    passphrase: &Passphrase,
    path: &Path,
) -> Result<Zeroizing<String>, PassphraseError> {
    let unsupported = || PassphraseError::Unsupported(path.into());
    let (label, document) = SecretDocument::from_pem(pem).map_err(|_| unsupported())?;
    let info = EncryptedPrivateKeyInfoRef::try_from(document.as_bytes()).map_err(|_| unsupported())?;
    if label != ENCRYPTED || !is_supported(&info.encryption_algorithm) {
        return Err(unsupported());
    }
    // A wrong passphrase is found by the padding or, by chance, only by the form of the decrypted bytes.
    let wrong = || PassphraseError::Wrong(path.into());
    let plain = info.decrypt(passphrase.0.as_bytes()).map_err(|_| wrong())?;
    if pkcs8::PrivateKeyInfoRef::try_from(plain.as_bytes()).is_err() {
        return Err(wrong());
    }
    plain.to_pem(PLAIN, LineEnding::LF).map_err(|_| wrong())
}

/// Whether this program can decrypt by this method, within its limits of memory and time.
fn is_supported(scheme: &EncryptionScheme) -> bool {
    let EncryptionScheme::Pbes2(Parameters { kdf, .. }) = scheme else { return false };
    match kdf {
        Kdf::Scrypt(scrypt) => {
            let ScryptParams { cost_parameter, block_size, parallelization, .. } = scrypt;
            let memory = cost_parameter.checked_mul(128 * u64::from(*block_size));
            // scrypt is defined only for powers of two.
            *cost_parameter >= 2
                && cost_parameter.is_power_of_two()
                && memory.is_some_and(|memory| (1..=MEMORY_MAX).contains(&memory))
                && (1..=PARALLELIZATION_MAX).contains(parallelization)
        }
        Kdf::Pbkdf2(pbkdf2) => {
            pbkdf2.iteration_count <= ITERATIONS_MAX && pbkdf2.prf != pbes2::Pbkdf2Prf::HmacWithSha1
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use rcgen::KeyPair;

    use super::*;

    /// Keys of the same pair, encrypted with the passphrase `sesame` by OpenSSL 3.0: with PBKDF2 and 2,048 iterations, and with scrypt.
    const BY_OPENSSL: [&str; 2] = [include_str!("fixtures/pbkdf2.pem"), include_str!("fixtures/scrypt.pem")];

    fn passphrase(text: &str) -> Passphrase {
        Passphrase::new(text.to_owned()).unwrap()
    }

    fn path() -> &'static Path {
        Path::new("authority.key")
    }

    #[test]
    fn encrypted_key_is_readable_only_with_its_passphrase() {
        let pem = KeyPair::generate().unwrap().serialize_pem();
        let encrypted = encrypt(&pem, &passphrase("sésame, ouvre-toi")).unwrap();
        assert!(is_encrypted(&encrypted) && !is_encrypted(&pem));
        let plain = decrypt(&encrypted, &passphrase("sésame, ouvre-toi"), path()).unwrap();
        let key = KeyPair::from_pem(&plain).unwrap();
        assert_eq!(key.serialize_der(), KeyPair::from_pem(&pem).unwrap().serialize_der());
        for wrong in ["sesame, ouvre-toi", "sésame, ouvre-toi ", "s"] {
            let error = decrypt(&encrypted, &passphrase(wrong), path()).unwrap_err();
            assert!(matches!(error, PassphraseError::Wrong(_)), "{error:?}");
        }
        assert_ne!(*encrypt(&pem, &passphrase("a")).unwrap(), *encrypt(&pem, &passphrase("a")).unwrap());
    }

    #[test]
    fn keys_encrypted_by_openssl_are_readable() {
        let [first, second] = BY_OPENSSL.map(|pem| {
            let plain = decrypt(pem, &passphrase("sesame"), path()).unwrap();
            KeyPair::from_pem(&plain).unwrap().serialize_der()
        });
        assert_eq!(first, second);
    }

    #[test]
    fn damaged_or_excessive_parameters_are_refused_at_once() {
        let unsupported = |pem: &str| {
            let error = decrypt(pem, &passphrase("sesame"), path()).unwrap_err();
            assert!(matches!(error, PassphraseError::Unsupported(_)), "{error:?}");
        };
        unsupported("");
        unsupported("-----BEGIN ENCRYPTED PRIVATE KEY-----\nAAAA\n-----END ENCRYPTED PRIVATE KEY-----\n");
        unsupported(&KeyPair::generate().unwrap().serialize_pem());
        let scheme = |cost_parameter, block_size, parallelization| {
            let salt = Salt::new([0; 16]).unwrap();
            let kdf = ScryptParams { salt, cost_parameter, block_size, parallelization, key_length: None };
            let encryption = pbes2::EncryptionScheme::Aes256Cbc { iv: [0; 16] };
            is_supported(&Parameters { kdf: kdf.into(), encryption }.into())
        };
        assert!(scheme(COST, BLOCK_SIZE, PARALLELIZATION) && scheme(1 << 17, 8, 1));
        for (cost, block_size, parallelization) in [
            (0, 8, 1),
            (1, 8, 1),
            (3, 8, 1),
            (1 << 14, 0, 1),
            (1 << 14, 8, 0),
            (1 << 14, 8, 65),
            (1 << 21, 8, 1),
            (1 << 63, u16::MAX, 1),
        ] {
            assert!(!scheme(cost, block_size, parallelization), "{cost} {block_size} {parallelization}");
        }
    }

    #[test]
    fn first_line_of_private_file_is_the_passphrase() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("passphrase");
        let read = |content: &[u8], mode: u32| {
            std::fs::write(&path, content).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            Passphrase::in_file(&path).map_err(|error| error.to_string())
        };
        for content in ["sesame", "sesame\n", "sesame\r\n", "sesame\nanother line\n"] {
            assert_eq!(read(content.as_bytes(), 0o600), Ok(passphrase("sesame")), "{content:?}");
        }
        assert_eq!(read(b" se same \n", 0o400), Ok(passphrase(" se same ")));
        assert!(read(b"\nsesame\n", 0o600).unwrap_err().contains("the passphrase is empty"));
        assert!(read(b"\xff\n", 0o600).unwrap_err().contains("not UTF-8 text"));
        assert!(read(b"sesame\n", 0o644).unwrap_err().contains("other users can read"));
        let missing = Passphrase::in_file(&folder.path().join("none")).unwrap_err().to_string();
        assert!(missing.contains("none: No such file"), "{missing}");
        assert_eq!(format!("{:?}", passphrase("sesame")), "Passphrase");
    }
}
