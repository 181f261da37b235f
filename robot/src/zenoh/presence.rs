//! The liveliness tokens in a Zenoh network, and the connections that end when their token disappears.

use std::collections::HashMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ::zenoh::sample::{Sample, SampleKind};
use tokio::sync::watch;

use super::keys::{Key, robot_of};
use super::stream::{Shared, WeakShared};

/// Maximum time to wait until a liveliness token appears.
const SEEN_WITHIN: Duration = Duration::from_secs(2);

#[derive(Debug, Default)]
struct Token {
    is_there: watch::Sender<bool>,
    pipes: Vec<WeakShared>,
}

#[derive(Debug, Default)]
struct TokenTable {
    /// The liveliness tokens that the session has observed, by key.
    tokens: HashMap<String, Token>,
    /// Number of present liveliness tokens of robots, by the robot's key. 0 if all tokens at this key have disappeared.
    robots: HashMap<String, usize>,
}

/// The liveliness tokens that a session observes.
#[derive(Clone, Debug, Default)]
pub(super) struct Tokens(Arc<Mutex<TokenTable>>);

/// Makes a connection depend on a liveliness token. When this value is dropped, the token is forgotten if it is absent and no other
/// connection depends on it.
pub(super) struct Following {
    tokens: Tokens,
    token: String,
}

impl Tokens {
    fn lock(&self) -> MutexGuard<'_, TokenTable> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Handles the appearance or disappearance of a liveliness token that Zenoh reports.
    pub(super) fn hear(&self, sample: &Sample) {
        self.change(sample.key_expr().as_str(), sample.kind() == SampleKind::Put);
    }

    fn change(&self, token: &str, is_there: bool) {
        let mut told = self.lock();
        let (was_there, pipes) = if is_there {
            (told.tokens.entry(token.to_owned()).or_default().is_there.send_replace(true), Vec::new())
        } else {
            let gone = told.tokens.remove(token).unwrap_or_default();
            (*gone.is_there.borrow(), gone.pipes)
        };
        if was_there != is_there
            && let Some(key) = robot_of(token)
        {
            let robots = told.robots.entry(key.to_owned()).or_default();
            *robots = if is_there { *robots + 1 } else { robots.saturating_sub(1) };
        }
        drop(told);
        for pipe in pipes.iter().filter_map(WeakShared::upgrade) {
            pipe.lock().break_off("the peer's process or the connection to it has ended");
        }
    }

    /// Whether a robot was once at this key and has disappeared. The caller need not search for it then. A search would cost network time
    /// that other robots need.
    pub(super) fn have_left(&self, key: &Key) -> bool {
        self.lock().robots.get(&key.to_string()) == Some(&0)
    }

    /// Makes a connection end when this liveliness token disappears. The token need not have appeared yet.
    pub(super) fn follow(&self, token: &str, pipe: &Shared) -> Following {
        let mut told = self.lock();
        let pipes = &mut told.tokens.entry(token.to_owned()).or_default().pipes;
        pipes.retain(WeakShared::is_alive);
        pipes.push(pipe.downgrade());
        Following { tokens: self.clone(), token: token.to_owned() }
    }

    /// Like [`Tokens::follow`], but waits until the token has appeared.
    pub(super) async fn follow_seen(&self, token: &str, pipe: &Shared) -> io::Result<Following> {
        let following = self.follow(token, pipe);
        let told = self.lock().tokens.get(token).map(|token| token.is_there.subscribe());
        let seen = async move { told?.wait_for(|there| *there).await.ok().map(drop) };
        match tokio::time::timeout(SEEN_WITHIN, seen).await {
            Ok(Some(())) => Ok(following),
            Ok(None) => Err(io::Error::new(io::ErrorKind::ConnectionReset, "the peer has just disconnected")),
            Err(_) => {
                let why = "the peer's liveliness token is not visible: allow it in the Zenoh access control";
                Err(io::Error::other(why))
            }
        }
    }
}

impl Drop for Following {
    fn drop(&mut self) {
        let mut told = self.tokens.lock();
        let Some(token) = told.tokens.get_mut(&self.token) else { return };
        token.pipes.retain(WeakShared::is_alive);
        if token.pipes.is_empty() && !*token.is_there.borrow() {
            told.tokens.remove(&self.token);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robot_has_left_once_none_of_its_tokens_remains() {
        let (tokens, key) = (Tokens::default(), "hall/arm".parse::<Key>().unwrap());
        assert!(!tokens.have_left(&key), "nothing is known of it");
        tokens.change("hall/arm/robot/1", false);
        assert!(!tokens.have_left(&key), "it was never seen");
        tokens.change("hall/arm/robot/1", true);
        tokens.change("hall/arm/robot/1", true);
        // The robot restarts before the network notices the end of its first process.
        tokens.change("hall/arm/robot/2", true);
        tokens.change("hall/arm/robot/1", false);
        assert!(!tokens.have_left(&key));
        tokens.change("hall/arm/robot/2", false);
        assert!(tokens.have_left(&key));
        tokens.change("hall/arm/robot/2", true);
        assert!(!tokens.have_left(&key));
    }

    #[test]
    fn connection_ends_only_with_its_own_token() {
        let (tokens, pipe) = (Tokens::default(), Shared::default());
        let following = tokens.follow("hall/scheduler/1", &pipe);
        tokens.change("hall/scheduler/1", true);
        tokens.change("hall/scheduler/2", true);
        tokens.change("hall/scheduler/2", false);
        assert!(!pipe.lock().is_broken());
        tokens.change("hall/scheduler/1", false);
        assert!(pipe.lock().is_broken());
        drop(following);
        assert!(tokens.lock().tokens.is_empty(), "nothing is kept of what has gone");
    }

    #[test]
    fn nothing_is_kept_of_a_token_never_seen() {
        let (tokens, pipe) = (Tokens::default(), Shared::default());
        let following = tokens.follow("hall/scheduler/1", &pipe);
        drop(pipe);
        drop(following);
        assert!(tokens.lock().tokens.is_empty());
    }
}
