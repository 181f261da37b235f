//! Several sessions with one network, for many robots.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use ::zenoh::Config;

use super::config::{self, NetworkError};
use super::network::{Network, Opening};

/// Maximum number of robots that one session reaches or shows. For each declaration, Zenoh searches all earlier declarations of the
/// session: with one session, 3,000 robots took a scheduler 17 s of processor time; with this number, 3.5 s.
const ROBOTS_A_SESSION: usize = 250;

/// Access to a Zenoh network for any number of robots, which are distributed among sessions. Clones share the same sessions. A session
/// ends with the last handle to it.
#[derive(Clone, Debug)]
pub struct Networks(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    config: Config,
    named: String,
    opening: Arc<Opening>,
    last: Mutex<Last>,
}

/// The session that gets the next robot.
#[derive(Debug)]
struct Last {
    network: Network,
    robots: usize,
    /// Maximum number of its robots.
    robots_max: usize,
}

impl Networks {
    /// Joins the network that a Zenoh configuration file describes. It does not search for other members by multicast, unless the file
    /// enables that.
    ///
    /// # Errors
    /// [`NetworkError`] if the file cannot be used, or none of its routers answers.
    pub fn open(file: &Path) -> Result<Self, NetworkError> {
        Self::with(config::read(file)?, file.display().to_string(), ROBOTS_A_SESSION)
    }

    /// The same with a configuration in JSON5.
    ///
    /// # Errors
    /// As [`Networks::open`].
    pub fn open_with(json5: &str) -> Result<Self, NetworkError> {
        Self::open_with_sessions_of(json5, ROBOTS_A_SESSION)
    }

    pub(super) fn open_with_sessions_of(json5: &str, robots: usize) -> Result<Self, NetworkError> {
        Self::with(config::parse(json5)?, "the configuration".to_owned(), robots)
    }

    fn with(config: Config, named: String, robots_a_session: usize) -> Result<Self, NetworkError> {
        let opening = Arc::<Opening>::default();
        let network = Network::with(config.clone(), &named, Arc::clone(&opening))?;
        // Members of one network have different ids, and a port can be used only once.
        let robots_max = if config::may_be_joined_again(&config) { robots_a_session } else { usize::MAX };
        let last = Mutex::new(Last { network, robots: 0, robots_max });
        Ok(Self(Arc::new(Inner { config, named, opening, last })))
    }

    /// Returns the session for one more robot. It is always the same if the configuration permits only one session, because it listens or
    /// sets an id. If no further session can be opened, all later robots share the last one.
    #[must_use]
    pub fn for_one_more(&self) -> Network {
        let Inner { config, named, opening, last } = &*self.0;
        let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.robots >= last.robots_max {
            match Network::with(config.clone(), named, Arc::clone(opening)) {
                Ok(network) => *last = Last { network, robots: 0, ..*last },
                Err(error) => {
                    tracing::warn!("more than {} robots share a Zenoh session: {error}", last.robots_max);
                    // Detecting that a network does not answer takes ten seconds.
                    last.robots_max = usize::MAX;
                }
            }
        }
        last.robots += 1;
        last.network.clone()
    }

    /// Returns an endpoint of its configuration that is neither on this machine nor protected by TLS.
    #[must_use]
    pub fn open_endpoint(&self) -> Option<String> {
        config::open_endpoint(&self.0.config)
    }
}
