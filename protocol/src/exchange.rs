//! Finds the open request that a response answers.

use std::collections::{HashMap, VecDeque};

use crate::message::ControlResponse;
use crate::text::{DeviceId, RequestId};

/// The requests sent on one link that are still open, each with a note that the sender attaches.
///
/// A response refers to its request by `request_id`. A response without `request_id` belongs to the oldest open request to its device.
#[derive(Clone, Debug)]
pub struct OpenRequests<T> {
    by_id: HashMap<RequestId, T>,
    oldest: HashMap<DeviceId, VecDeque<RequestId>>,
}

impl<T> Default for OpenRequests<T> {
    fn default() -> Self {
        Self { by_id: HashMap::new(), oldest: HashMap::new() }
    }
}

impl<T> OpenRequests<T> {
    /// Adds a request, or replaces the note of an open request with the same id.
    pub fn open(&mut self, device_id: DeviceId, request_id: RequestId, note: T) {
        if self.by_id.insert(request_id.clone(), note).is_none() {
            self.oldest.entry(device_id).or_default().push_back(request_id);
        }
    }

    /// Returns the open request that `response` belongs to; `None` if there is no such request. The request stays open for further
    /// responses until [`OpenRequests::close`].
    #[must_use]
    pub fn find(&self, response: &ControlResponse) -> Option<(&RequestId, &T)> {
        match &response.request_id {
            Some(id) => self.by_id.get_key_value(id),
            None => {
                let id = self.oldest.get(&response.device_id)?.front()?;
                self.by_id.get_key_value(id)
            }
        }
    }

    /// Removes a request that awaits no further responses. Returns its note; `None` if the request is not open.
    pub fn close(&mut self, device_id: &DeviceId, request_id: &RequestId) -> Option<T> {
        if let Some(queue) = self.oldest.get_mut(device_id) {
            queue.retain(|id| id != request_id);
        }
        self.by_id.remove(request_id)
    }

    /// Number of open requests.
    #[must_use]
    pub fn len(&self) -> usize {
        self.by_id.len()
    }

    /// Whether no request is open.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.by_id.is_empty()
    }
}
