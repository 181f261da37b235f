//! Several sessions in one Zenoh network, among which a process distributes its robots.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use ::zenoh::Config;

use super::config::{self, NetworkError};
use super::network::{Network, Opening};

/// Maximum number of robots that one session connects to or makes reachable. For each declaration, Zenoh searches all earlier
/// declarations of the session. For 3,000 robots, a scheduler took 17 s of processor time with one session, and 3.5 s with 250 robots per
/// session.
const ROBOTS_A_SESSION: usize = 250;

/// Access to a Zenoh network for any number of robots, which are distributed among several sessions. Clones share these sessions. A
/// session ends when its last handle is dropped.
#[derive(Clone, Debug)]
pub struct Networks(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    config: Config,
    named: String,
    opening: Arc<Opening>,
    last: Mutex<Last>,
}

/// The session to which the next robot is assigned.
#[derive(Debug)]
struct Last {
    network: Network,
    robots: usize,
    /// Maximum number of robots that may share this session.
    robots_max: usize,
}

impl Networks {
    /// Joins the network that a Zenoh configuration file describes. Its sessions search for other members by multicast only if the file
    /// enables this.
    ///
    /// # Errors
    /// [`NetworkError`] if the file cannot be used, or if none of its routers answers.
    pub fn open(file: &Path) -> Result<Self, NetworkError> {
        Self::with(config::read(file)?, file.display().to_string(), ROBOTS_A_SESSION)
    }

    /// Like [`Networks::open`], but takes the configuration as a JSON5 text.
    ///
    /// # Errors
    /// Those of [`Networks::open`].
    pub fn open_with(json5: &str) -> Result<Self, NetworkError> {
        Self::open_with_sessions_of(json5, ROBOTS_A_SESSION)
    }

    pub(super) fn open_with_sessions_of(json5: &str, robots: usize) -> Result<Self, NetworkError> {
        Self::with(config::parse(json5)?, "the configuration".to_owned(), robots)
    }

    fn with(config: Config, named: String, robots_a_session: usize) -> Result<Self, NetworkError> {
        let opening = Arc::<Opening>::default();
        let network = Network::with(config.clone(), &named, Arc::clone(&opening))?;
        // Members of one network must have different ids, and only one session can listen on a port.
        let robots_max = if config::may_be_joined_again(&config) { robots_a_session } else { usize::MAX };
        let last = Mutex::new(Last { network, robots: 0, robots_max });
        Ok(Self(Arc::new(Inner { config, named, opening, last })))
    }

    /// Returns the session to use for one more robot. If the configuration permits only one session, because it listens or sets an id,
    /// this is always the same session. If no further session can be opened, all later robots share the last session.
    #[must_use]
    pub fn for_one_more(&self) -> Network {
        let Inner { config, named, opening, last } = &*self.0;
        let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.robots >= last.robots_max {
            match Network::with(config.clone(), named, Arc::clone(opening)) {
                Ok(network) => *last = Last { network, robots: 0, ..*last },
                Err(error) => {
                    tracing::warn!(
                        "more than {} robots now share one Zenoh session, because another session cannot be opened: {error}",
                        last.robots_max
                    );
                    // Does not try again: detecting that a network does not answer takes ten seconds.
                    last.robots_max = usize::MAX;
                }
            }
        }
        last.robots += 1;
        last.network.clone()
    }

    /// Returns an endpoint of the network's configuration that is neither on this machine nor protected by TLS. `None` if there is no
    /// such endpoint.
    #[must_use]
    pub fn open_endpoint(&self) -> Option<String> {
        config::open_endpoint(&self.0.config)
    }
}
