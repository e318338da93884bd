// The unix port's stream: a socket whose number is in THIGMO_HARDWARE, read by a thread of its own.
#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "controller.h"
#include "py/runtime.h"
#include "stream.h"

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static int hardware = -1;
static volatile bool gone;

static void* receive(void* unused) {
  (void)unused;
  static uint8_t bytes[4096];
  for (;;) {
    const ssize_t count = read(hardware, bytes, sizeof bytes);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) break;
    pthread_mutex_lock(&lock);
    injected_receive(bytes, (uint32_t)count);
    pthread_mutex_unlock(&lock);
  }
  gone = true;
  return NULL;
}

const char* stream_open(void) {
  if (hardware >= 0) return NULL;
  const char* number = getenv("THIGMO_HARDWARE");
  if (number == NULL) {
    return "no hardware here: `thigmo emulate SCENE --prompt` gives this program an emulated robot";
  }
  hardware = atoi(number);
  // Signals are Python's: its thread takes Ctrl-C.
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  pthread_t thread;
  const int failed = pthread_create(&thread, NULL, receive, NULL);
  pthread_sigmask(SIG_SETMASK, &before, NULL);
  return failed ? "the controller's thread cannot be started" : NULL;
}

void stream_send(const uint8_t* bytes, uint32_t count) {
  while (count != 0) {
    const ssize_t sent = write(hardware, bytes, count);
    if (sent < 0 && errno == EINTR) continue;
    if (sent <= 0) {
      gone = true;
      return;
    }
    bytes += sent;
    count -= (uint32_t)sent;
  }
}

void stream_take(uint8_t* bytes, uint32_t count) {
  while (count != 0) {
    const ssize_t taken = read(hardware, bytes, count);
    if (taken < 0 && errno == EINTR) continue;
    if (taken <= 0) {
      memset(bytes, 0xFF, count);
      gone = true;
      return;
    }
    bytes += taken;
    count -= (uint32_t)taken;
  }
}

void stream_lock(void) { pthread_mutex_lock(&lock); }
void stream_unlock(void) { pthread_mutex_unlock(&lock); }

bool stream_wait(void) {
  usleep(1000);
  return !gone;
}

int __real_mp_hal_stdin_rx_chr(void);
int thigmo_key(void) {
  struct pollfd keys = {STDIN_FILENO, POLLIN, 0};
  while (poll(&keys, 1, 5) <= 0) mp_handle_pending(false);
  return __real_mp_hal_stdin_rx_chr();
}
