//! The side that connects to a robot.

use std::any::Any;
use std::io;
use std::time::Duration;

use ::zenoh::query::{QueryTarget, Reply};
use ::zenoh::sample::Sample;
use ::zenoh::{Session, Wait};
use tokio::sync::{mpsc, oneshot};

use super::keys::{Key, LinkId, STOPS};
use super::network::{Haste, Network};
use super::stream::{Shared, Stream, Target, link_of};

/// How long the answer of a robot may take.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);

/// Connects to the robot at a key.
///
/// # Errors
/// No robot is there, several are, or the network does not carry.
pub async fn connect(network: &Network, key: &Key, haste: Haste) -> io::Result<Stream> {
    let nobody = || {
        let why = "no robot answers there: it is not running, or a router on the way is not";
        io::Error::new(io::ErrorKind::NotFound, why)
    };
    if network.tokens().have_left(key) {
        return Err(nobody());
    }
    let (link, pipe) = (network.connection()?, Shared::default());
    let (answer, mut answers) = mpsc::unbounded_channel();
    let (told, opened) = oneshot::channel();
    let stream = Stream::new(network.clone(), pipe.clone(), (link, Target::new(key.to())?), haste);
    let opening = Opening { key: key.clone(), network: network.clone(), link, pipe: pipe.clone(), haste };
    network.declare(haste, move |session| {
        let _waits = told.send(opening.open(session, answer).map_err(|error| error.to_string()));
    });
    let kept = opened.await.map_err(|_| io::Error::other("the Zenoh session has ended"))?;
    let kept = kept.map_err(io::Error::other)?;
    let mut robots = Vec::new();
    while let Some(answer) = answers.recv().await {
        robots.push(answer.map_err(|why| io::Error::new(io::ErrorKind::TimedOut, why))?);
    }
    let robot = match robots.as_slice() {
        [robot] => robot,
        [] => return Err(nobody()),
        _ => return Err(io::Error::other("several robots answer there: each needs a key of its own")),
    };
    let following = network.tokens().follow_seen(&key.robot(robot), &pipe).await?;
    Ok(stream.keeping(Box::new((kept, following))))
}

/// A connection that is about to be opened.
struct Opening {
    key: Key,
    network: Network,
    link: LinkId,
    pipe: Shared,
    haste: Haste,
}

impl Opening {
    /// Declares all that a connection lives by, and then asks the robot for it; returns what has to be kept for as long as it lives.
    fn open(
        self,
        session: &Session,
        answer: mpsc::UnboundedSender<Result<String, String>>,
    ) -> ::zenoh::Result<Box<dyn Any + Send>> {
        let Self { key, network, link, pipe, haste } = self;
        network.watch(session, key.robots_beside())?;
        network.show(session, key.scheduler(network.id()))?;
        // Declared by itself, so that Zenoh hands frames to the connections of this robot, and compares them with no others.
        let from = session.declare_keyexpr(key.from(network.id())).wait()?;
        let frames = session.declare_subscriber(from.clone());
        let own = move |sample: Sample| {
            if link_of(&sample) == Some(link) {
                pipe.receive(&sample);
            }
        };
        let frames = frames.callback(own).wait()?;
        let reply = move |reply: Reply| {
            let said = reply.result().map_err(|error| read(error.payload()));
            let _gave_up = answer.send(said.map(|sample| read(sample.payload())));
        };
        let asked = match haste {
            Haste::None => link.to_string(),
            Haste::Stop => format!("{link} {STOPS}"),
        };
        let asking = session.get(key.open()).payload(asked).target(QueryTarget::All);
        asking.timeout(ANSWERS_WITHIN).priority(haste.priority()).callback(reply).wait()?;
        Ok(Box::new((frames, from)))
    }
}

fn read(payload: &::zenoh::bytes::ZBytes) -> String {
    String::from_utf8_lossy(&payload.to_bytes()).into_owned()
}
