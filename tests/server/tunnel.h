/* TLS for clients: a self-made certificate, a session, and a tunnel. The tunnel lets tests that use
 * plain sockets run against a server with TLS.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_TUNNEL_H
#define TESTS_TUNNEL_H

#include "tests/kit.h"

#include <gnutls/gnutls.h>
#include <gnutls/x509.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

/* ---- a certificate ---- */

static inline void tunnel_put(const char *dir, const char *name, gnutls_datum_t *d, unsigned mode,
                              char out[FILE_PATH_MAX])
{
    struct err e = {0};
    kit_ok(file_join(out, dir, name, &e), e);
    kit_ok(file_write(out, d->data, d->size, &e), e);
    assert_int_equal(chmod(out, mode), 0);
    gnutls_free(d->data);
}

/* Writes dir/NAME.crt and dir/NAME.key for the common name `name`, valid for `days` days. */
static inline void tunnel_pair(const char *dir, const char *name, int days,
                               char cert[FILE_PATH_MAX], char key[FILE_PATH_MAX])
{
    gnutls_x509_privkey_t k;
    gnutls_x509_crt_t c;
    gnutls_datum_t pem;
    char file[80], serial[5] = {1, 2, 3, 4, (char)days};
    assert_int_equal(gnutls_x509_privkey_init(&k), 0);
    assert_int_equal(gnutls_x509_privkey_generate(k, GNUTLS_PK_ECDSA, 256, 0), 0);
    assert_int_equal(gnutls_x509_crt_init(&c), 0);
    assert_int_equal(gnutls_x509_crt_set_version(c, 3), 0);
    assert_int_equal(gnutls_x509_crt_set_serial(c, serial, sizeof serial), 0);
    assert_int_equal(gnutls_x509_crt_set_dn_by_oid(c, GNUTLS_OID_X520_COMMON_NAME, 0, name,
                                                   (unsigned)strlen(name)),
                     0);
    assert_int_equal(gnutls_x509_crt_set_activation_time(c, time(NULL) - 86400 * 40), 0);
    assert_int_equal(gnutls_x509_crt_set_expiration_time(c, time(NULL) + 86400 * days), 0);
    assert_int_equal(gnutls_x509_crt_set_key(c, k), 0);
    assert_int_equal(gnutls_x509_crt_sign2(c, c, k, GNUTLS_DIG_SHA256, 0), 0);
    assert_int_equal(gnutls_x509_crt_export2(c, GNUTLS_X509_FMT_PEM, &pem), 0);
    snprintf(file, sizeof file, "%s.crt", name);
    tunnel_put(dir, file, &pem, 0644, cert);
    assert_int_equal(gnutls_x509_privkey_export2(k, GNUTLS_X509_FMT_PEM, &pem), 0);
    snprintf(file, sizeof file, "%s.key", name);
    tunnel_put(dir, file, &pem, 0600, key);
    gnutls_x509_crt_deinit(c);
    gnutls_x509_privkey_deinit(k);
}

/* ---- a session ---- */

struct tunnel {
    gnutls_session_t session;
    gnutls_certificate_credentials_t credentials;
    int fd, near; /* near: the client's side of a tunnel */
    int error;    /* result of the handshake */
};

static inline int tunnel_dial(uint16_t port)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(port)};
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    return fd >= 0 && connect(fd, (struct sockaddr *)&a, sizeof a) == 0 ? fd : -1;
}

/* Opens a session and accepts any certificate. Returns false: the handshake failed. */
static inline bool tunnel_open(struct tunnel *x, uint16_t port, const char *priorities)
{
    memset(x, 0, sizeof *x);
    x->near = -1;
    x->fd = tunnel_dial(port);
    if (x->fd < 0 || gnutls_certificate_allocate_credentials(&x->credentials) ||
        gnutls_init(&x->session, GNUTLS_CLIENT) ||
        gnutls_priority_set_direct(x->session, priorities, NULL) ||
        gnutls_credentials_set(x->session, GNUTLS_CRD_CERTIFICATE, x->credentials))
        return false;
    gnutls_transport_set_int(x->session, x->fd);
    gnutls_handshake_set_timeout(x->session, 20000);
    do
        x->error = gnutls_handshake(x->session);
    while (x->error == GNUTLS_E_AGAIN || x->error == GNUTLS_E_INTERRUPTED);
    return x->error == 0;
}

static inline void tunnel_close(struct tunnel *x)
{
    if (x->session)
        gnutls_deinit(x->session);
    if (x->credentials)
        gnutls_certificate_free_credentials(x->credentials);
    if (x->fd >= 0)
        close(x->fd);
    if (x->near >= 0)
        close(x->near);
    memset(x, 0, sizeof *x);
    x->fd = x->near = -1;
}

/* Common name of the server's certificate. */
static inline void tunnel_name(const struct tunnel *x, char out[80])
{
    unsigned n = 0;
    size_t room = 80;
    gnutls_x509_crt_t c;
    const gnutls_datum_t *list = gnutls_certificate_get_peers(x->session, &n);
    assert_true(list && n > 0);
    assert_int_equal(gnutls_x509_crt_init(&c), 0);
    assert_int_equal(gnutls_x509_crt_import(c, &list[0], GNUTLS_X509_FMT_DER), 0);
    assert_int_equal(
        gnutls_x509_crt_get_dn_by_oid(c, GNUTLS_OID_X520_COMMON_NAME, 0, 0, out, &room), 0);
    gnutls_x509_crt_deinit(c);
}

/* ---- a tunnel ---- */

/* Pretends that all bytes were sent. If the server has closed, GnuTLS would otherwise not read its
 * last answer. */
static inline ssize_t tunnel_push(gnutls_transport_ptr_t fd, const void *bytes, size_t n)
{
    ssize_t sent = send((int)(intptr_t)fd, bytes, n, MSG_NOSIGNAL);
    return sent < 0 ? (ssize_t)n : sent;
}

/* Copies bytes in both directions until one side ends. */
static inline void *tunnel_carry(void *user)
{
    struct tunnel *x = user;
    char bytes[16384];
    bool sends = true;
    gnutls_transport_set_push_function(x->session, tunnel_push);
    for (;;) {
        struct pollfd p[2] = {{.fd = x->fd, .events = POLLIN},
                              {.fd = sends ? x->near : -1, .events = POLLIN}};
        bool pending = gnutls_record_check_pending(x->session) > 0;
        if (!pending && poll(p, 2, 60000) <= 0)
            break;
        if (pending || p[0].revents) {
            ssize_t n = gnutls_record_recv(x->session, bytes, sizeof bytes);
            if (n == GNUTLS_E_AGAIN || n == GNUTLS_E_INTERRUPTED)
                continue;
            if (n <= 0 || send(x->near, bytes, (size_t)n, MSG_NOSIGNAL) != n)
                break;
        } else if (p[1].revents) {
            ssize_t n = recv(x->near, bytes, sizeof bytes, 0);
            if (n < 0)
                break;
            if (n == 0) { /* the client has sent everything and may still read */
                sends = false;
                (void)gnutls_bye(x->session, GNUTLS_SHUT_WR);
                (void)shutdown(x->fd, SHUT_WR);
            } else if (gnutls_record_send(x->session, bytes, (size_t)n) != n) {
                sends = false; /* the server reads no more; its answer can still be read */
            }
        }
    }
    tunnel_close(x);
    free(x);
    return NULL;
}

struct tunnels {
    int fd;
    uint16_t port, to;
    pthread_t thread;
};

static inline void *tunnel_accept(void *user)
{
    const struct tunnels *all = user;
    for (;;) {
        int near = accept(all->fd, NULL, NULL);
        pthread_t thread;
        struct tunnel *x = near >= 0 ? calloc(1, sizeof *x) : NULL;
        if (near < 0)
            return NULL;
        if (!x || !tunnel_open(x, all->to, "NORMAL")) {
            if (x)
                tunnel_close(x);
            free(x);
            close(near);
            continue;
        }
        x->near = near;
        assert_int_equal(pthread_create(&thread, NULL, tunnel_carry, x), 0);
        pthread_detach(thread);
    }
}

/* From now on, connections to all->port are forwarded to port `to` by TLS. */
static inline void tunnels_open(struct tunnels *all, uint16_t to)
{
    struct sockaddr_in a = {.sin_family = AF_INET};
    socklen_t n = sizeof a;
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    all->to = to;
    all->fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_true(all->fd >= 0);
    assert_int_equal(bind(all->fd, (struct sockaddr *)&a, sizeof a), 0);
    assert_int_equal(listen(all->fd, 256), 0);
    assert_int_equal(getsockname(all->fd, (struct sockaddr *)&a, &n), 0);
    all->port = ntohs(a.sin_port);
    assert_int_equal(pthread_create(&all->thread, NULL, tunnel_accept, all), 0);
}

static inline void tunnels_close(struct tunnels *all)
{
    (void)shutdown(all->fd, SHUT_RDWR);
    pthread_join(all->thread, NULL);
    close(all->fd);
}

#endif
