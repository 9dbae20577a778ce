/* tracker.c: a source of comotion in C.
 *
 *     cc -O2 -std=c11 tracker.c -lm -o tracker                    batches to standard output
 *     cc -O2 -std=c11 -DWITH_ZENOH tracker.c -lzenohc -lm -o tracker   batches to the router
 */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define SOURCE "c-tracker"
#define N 30
#define DIM 3
/* Columns are little-endian; on a big-endian machine swap the bytes of every number. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "swap the columns");

/* ---- msgpack, as much as a batch needs; its own integers are big-endian ---- */

typedef struct {
    uint8_t *data;
    size_t size, capacity;
} Buffer;

static void put(Buffer *b, const void *bytes, size_t count) {
    if (b->size + count > b->capacity) {
        b->capacity = 2 * (b->size + count);
        b->data = realloc(b->data, b->capacity);
        if (!b->data) abort();
    }
    memcpy(b->data + b->size, bytes, count);
    b->size += count;
}

static void put_big_endian(Buffer *b, uint8_t tag, uint64_t value, int bytes) {
    put(b, &tag, 1);
    while (bytes--) {
        uint8_t byte = (uint8_t)(value >> (8 * bytes));
        put(b, &byte, 1);
    }
}

static void put_map(Buffer *b, uint16_t fields) { put_big_endian(b, 0xde, fields, 2); }

static void put_str(Buffer *b, const char *text) {
    put_big_endian(b, 0xd9, strlen(text), 1); /* up to 255 bytes */
    put(b, text, strlen(text));
}

static void put_int(Buffer *b, const char *key, uint64_t value) {
    put_str(b, key);
    put_big_endian(b, 0xcf, value, 8);
}

static void put_text(Buffer *b, const char *key, const char *value) {
    put_str(b, key);
    put_str(b, value);
}

static void put_column(Buffer *b, const char *key, const void *numbers, size_t bytes) {
    put_str(b, key);
    put_big_endian(b, 0xc6, bytes, 4);
    put(b, numbers, bytes);
}

/* ---- one ObservationBatch ---- */

static void encode(Buffer *b, const char *session, uint64_t seq, int64_t stamp_ns, size_t n,
                   const uint64_t *ids, const float *positions /* n rows of DIM */) {
    b->size = 0;
    put_map(b, 10);
    put_text(b, "schema", "comotion.ObservationBatch/1");
    put_text(b, "source", SOURCE);
    put_text(b, "session", session);
    put_int(b, "seq", seq);
    put_text(b, "space", "world");
    put_text(b, "unit", "m");
    put_int(b, "dim", DIM);
    put_int(b, "stamp_ns", (uint64_t)stamp_ns);
    put_column(b, "ids", ids, n * sizeof *ids);
    put_column(b, "positions", positions, n * DIM * sizeof *positions);
}

/* ---- where batches go ---- */

#ifdef WITH_ZENOH
#include <zenoh.h> /* zenoh-c 1.x */
static z_owned_session_t zenoh;
static z_owned_publisher_t publisher;
static z_owned_liveliness_token_t token;

static int open_output(void) {
    z_owned_config_t config;
    z_config_default(&config);
    zc_config_insert_json5(z_loan_mut(config), "mode", "\"client\"");
    zc_config_insert_json5(z_loan_mut(config), "connect/endpoints", "[\"tcp/127.0.0.1:7447\"]");
    zc_config_insert_json5(z_loan_mut(config), "scouting/multicast/enabled", "false");
    zc_config_insert_json5(z_loan_mut(config), "scouting/gossip/enabled", "false");
    zc_config_insert_json5(z_loan_mut(config), "transport/shared_memory/enabled", "false");
    if (z_open(&zenoh, z_move(config), NULL) < 0) return -1;
    z_view_keyexpr_t key;
    z_view_keyexpr_from_str(&key, "comotion/@v1/default/live/source/" SOURCE);
    if (z_liveliness_declare_token(z_loan(zenoh), &token, z_loan(key), NULL) < 0) return -1;
    z_owned_encoding_t encoding;
    z_encoding_from_str(&encoding, "application/msgpack;comotion.ObservationBatch/1");
    z_publisher_options_t options;
    z_publisher_options_default(&options);
    options.encoding = z_move(encoding);
    options.congestion_control = Z_CONGESTION_CONTROL_DROP;
    z_view_keyexpr_from_str(&key, "comotion/@v1/default/obs/" SOURCE);
    return z_declare_publisher(z_loan(zenoh), &publisher, z_loan(key), &options);
}

static int publish(const Buffer *b) {
    z_owned_bytes_t payload;
    z_bytes_copy_from_buf(&payload, b->data, b->size);
    return z_publisher_put(z_loan(publisher), z_move(payload), NULL);
}
#else /* each batch after its length, four bytes, little-endian */
static int open_output(void) { return 0; }

static int publish(const Buffer *b) {
    uint32_t length = (uint32_t)b->size;
    int sent = fwrite(&length, sizeof length, 1, stdout) == 1 && fwrite(b->data, b->size, 1, stdout) == 1;
    return sent && fflush(stdout) == 0 ? 0 : -1;
}
#endif

/* ---- the tracker: a box that swings above a floor ---- */

static float uniform(float low, float high) { return low + (high - low) * (float)rand() / (float)RAND_MAX; }

int main(void) {
    struct timespec now, pause = {.tv_nsec = 1000000000 / 30};
    clock_gettime(CLOCK_REALTIME, &now);
    char session[17]; /* 16 hex digits, new at each start */
    snprintf(session, sizeof session, "%016llx", (unsigned long long)now.tv_sec * 1000000000ull + (unsigned long long)now.tv_nsec);

    uint64_t ids[N];
    float rest[N][DIM], seen[N][DIM];
    for (int i = 0; i < N; i++) {
        float reach = i < 10 ? 0.1f : 1.0f;
        ids[i] = (uint64_t)i; /* never given to another feature */
        for (int k = 0; k < DIM; k++) rest[i][k] = uniform(-reach, reach);
    }
    if (open_output() < 0) return 2;
    Buffer batch = {0};
    for (uint64_t seq = 0;; seq++) {
        clock_gettime(CLOCK_REALTIME, &now); /* when the sensor saw it */
        double t = (double)(now.tv_sec % 1000) + 1e-9 * (double)now.tv_nsec;
        memcpy(seen, rest, sizeof seen);
        for (int i = 0; i < 10; i++) {
            seen[i][0] += 0.4f * (float)sin(t);
            seen[i][2] += 0.5f;
        }
        encode(&batch, session, seq, now.tv_sec * 1000000000ll + now.tv_nsec, N, ids, &seen[0][0]);
        if (publish(&batch) < 0) return 0; /* nobody listens any more */
        nanosleep(&pause, NULL);
    }
}
