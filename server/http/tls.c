/* TLS by libmicrohttpd and GnuTLS. libmicrohttpd reads decrypted bytes with gnutls_record_recv(),
 * as it reads other sockets with recv(). This file defines that function for the same reason for
 * which request_screen.c defines recv(): bytes pass the screen before a parser gets them. Records
 * are read with gnutls_record_recv_seq(); sessions without a screen use that directly. GnuTLS's own
 * recv(), for encrypted bytes, does not use the screen.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http/tls.h"

#include <errno.h>
#include <fcntl.h>
#include <gnutls/x509.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "server/http/request_screen.h"

enum { TLS_CHAIN_MAX = 16, TLS_FILE_MAX = 1 << 20, TLS_SOON_DAYS = 14 };

struct tls_pair {
    gnutls_pcert_st chain[TLS_CHAIN_MAX];
    unsigned n;
    gnutls_privkey_t key;
    struct hash128 hash; /* of both files */
    time_t until;
    char name[200];
    struct tls_pair *older;
};

struct tls {
    char *cert_path, *key_path;
    pthread_mutex_t lock; /* of now and all that is older */
    struct tls_pair *now; /* replaced ones stay to the end: a handshake may still use them */
};

/* ---- files ---- */

static enum err_code tls_gnutls(int rc, enum err_code code, const char *option, const char *path,
                                struct err *e)
{
    if (rc == GNUTLS_E_MEMORY_ERROR)
        return err_set(e, ERR_MEM, "tls: out of memory");
    return rc < 0 ? err_set(e, code, "%s %s: %s", option, path, gnutls_strerror(rc)) : ERR_OK;
}

/* Do key and certificate belong together? */
static enum err_code tls_check_pair(const struct tls *t, const gnutls_datum_t *cert,
                                    const gnutls_datum_t *key, struct err *e)
{
    gnutls_certificate_credentials_t c = NULL;
    int rc = gnutls_certificate_allocate_credentials(&c);
    if (rc == GNUTLS_E_SUCCESS)
        rc = gnutls_certificate_set_x509_key_mem2(c, cert, key, GNUTLS_X509_FMT_PEM, NULL, 0);
    gnutls_certificate_free_credentials(c);
    if (rc == GNUTLS_E_CERTIFICATE_KEY_MISMATCH)
        return err_set(e, ERR_DATA, "--tls-key %s: it is not the key of the certificate of %s",
                       t->key_path, t->cert_path);
    return tls_gnutls(rc, ERR_FORMAT, "--tls-cert", t->cert_path, e);
}

/* Whose the certificate is, and until when. */
static enum err_code tls_describe(const struct tls *t, const gnutls_datum_t *cert,
                                  struct tls_pair *p, struct err *e)
{
    gnutls_x509_crt_t crt = NULL;
    size_t room = sizeof p->name - 1;
    int rc = gnutls_x509_crt_init(&crt);
    if (rc == GNUTLS_E_SUCCESS)
        rc = gnutls_x509_crt_import(crt, cert, GNUTLS_X509_FMT_PEM);
    if (rc == GNUTLS_E_SUCCESS) {
        p->until = gnutls_x509_crt_get_expiration_time(crt);
        if (gnutls_x509_crt_get_dn(crt, p->name, &room) < 0)
            p->name[0] = '\0';
    }
    gnutls_x509_crt_deinit(crt);
    return tls_gnutls(rc, ERR_FORMAT, "--tls-cert", t->cert_path, e);
}

static void tls_warn(const struct tls *t, const struct tls_pair *p)
{
    double days = difftime(p->until, time(NULL)) / 86400;
    if (days < TLS_SOON_DAYS)
        log_warn("serve", "the certificate of %s %s", t->cert_path,
                 days < 0 ? "has expired: clients will refuse it" : "expires within two weeks");
}

static enum err_code tls_import(const struct tls *t, const gnutls_datum_t *cert,
                                const gnutls_datum_t *key, struct tls_pair *p, struct err *e)
{
    unsigned n = TLS_CHAIN_MAX;
    enum err_code rc = tls_check_pair(t, cert, key, e);
    if (!rc)
        rc = tls_describe(t, cert, p, e);
    if (!rc)
        rc = tls_gnutls(gnutls_privkey_init(&p->key), ERR_MEM, "--tls-key", t->key_path, e);
    if (!rc)
        rc = tls_gnutls(gnutls_privkey_import_x509_raw(p->key, key, GNUTLS_X509_FMT_PEM, NULL, 0),
                        ERR_FORMAT, "--tls-key", t->key_path, e);
    if (!rc)
        rc = tls_gnutls(
            gnutls_pcert_list_import_x509_raw(p->chain, &n, cert, GNUTLS_X509_FMT_PEM,
                                              GNUTLS_X509_CRT_LIST_IMPORT_FAIL_IF_EXCEED),
            ERR_FORMAT, "--tls-cert", t->cert_path, e);
    p->n = rc ? 0 : n;
    return rc;
}

void tls_discard(struct tls_pair **pair)
{
    struct tls_pair *p = *pair;
    *pair = NULL;
    if (!p)
        return;
    for (unsigned i = 0; i < p->n; i++)
        gnutls_pcert_deinit(&p->chain[i]);
    if (p->key)
        gnutls_privkey_deinit(p->key);
    mem_free(p);
}

enum err_code tls_read(const struct tls *t, struct tls_pair **pair, struct err *e)
{
    struct buf cert = {0}, key = {0};
    struct tls_pair *p = *pair = mem_array(1, sizeof *p);
    enum err_code rc = p ? file_check_secret(t->key_path, "--tls-key", e)
                         : err_set(e, ERR_MEM, "tls: out of memory");
    if (!rc)
        rc = file_read(t->cert_path, TLS_FILE_MAX, &cert, e);
    if (!rc)
        rc = file_read(t->key_path, TLS_FILE_MAX, &key, e);
    const gnutls_datum_t cert_pem = {cert.data, (unsigned)cert.size},
                         key_pem = {key.data, (unsigned)key.size};
    if (!rc)
        rc = tls_import(t, &cert_pem, &key_pem, p, e);
    if (!rc) {
        const struct hash128 both[2] = {hash_bytes(cert.data, cert.size),
                                        hash_bytes(key.data, key.size)};
        p->hash = hash_bytes(both, sizeof both);
        tls_warn(t, p);
    } else {
        tls_discard(pair);
    }
    if (key.data)
        gnutls_memset(key.data, 0, key.size);
    buf_free(&cert);
    buf_free(&key);
    return rc;
}

void tls_use(struct tls *t, struct tls_pair **pair)
{
    struct tls_pair *p = *pair;
    *pair = NULL;
    if (!p)
        return;
    pthread_mutex_lock(&t->lock);
    bool same = t->now && t->now->hash.lo == p->hash.lo && t->now->hash.hi == p->hash.hi;
    if (!same) {
        p->older = t->now;
        t->now = p;
    }
    pthread_mutex_unlock(&t->lock);
    if (same)
        tls_discard(&p);
}

/* ---- life ---- */

enum err_code tls_open(const char *cert_path, const char *key_path, struct tls **out, struct err *e)
{
    struct tls_pair *pair = NULL;
    *out = NULL;
    if (!cert_path || !key_path)
        return err_set(e, ERR_ARG, "%s is missing: TLS needs --tls-cert and --tls-key",
                       cert_path ? "--tls-key" : "--tls-cert");
    struct tls *t = mem_array(1, sizeof *t);
    if (!t || !(t->cert_path = mem_text(cert_path)) || !(t->key_path = mem_text(key_path))) {
        if (t)
            mem_free(t->cert_path);
        mem_free(t);
        return err_set(e, ERR_MEM, "tls: out of memory");
    }
    pthread_mutex_init(&t->lock, NULL);
    *out = t;
    enum err_code rc = tls_read(t, &pair, e);
    if (!rc)
        tls_use(t, &pair);
    else
        tls_close(out);
    return rc;
}

void tls_close(struct tls **out)
{
    struct tls *t = *out;
    *out = NULL;
    if (!t)
        return;
    for (struct tls_pair *p = t->now, *older; p; p = older) {
        older = p->older;
        tls_discard(&p);
    }
    pthread_mutex_destroy(&t->lock);
    mem_free(t->cert_path);
    mem_free(t->key_path);
    mem_free(t);
}

double tls_days_left(struct tls *t)
{
    pthread_mutex_lock(&t->lock);
    const double left_s = difftime(t->now->until, time(NULL));
    pthread_mutex_unlock(&t->lock);
    return left_s / 86400;
}

void tls_about(struct tls *t, char *out, size_t room)
{
    char day[16] = "";
    struct tm tm;
    pthread_mutex_lock(&t->lock);
    if (gmtime_r(&t->now->until, &tm))
        strftime(day, sizeof day, "%Y-%m-%d", &tm);
    snprintf(out, room, "certificate of %s, until %s", t->now->name, day);
    pthread_mutex_unlock(&t->lock);
}

/* ---- sessions ---- */

int tls_certificate(gnutls_session_t session, const gnutls_datum_t *issuers, int n_issuers,
                    const gnutls_pk_algorithm_t *kinds, int n_kinds, gnutls_pcert_st **out,
                    unsigned *n_out, gnutls_privkey_t *key)
{
    const struct request_screen *s = request_screen_at(gnutls_transport_get_int(session));
    struct tls *t = s ? s->tls : NULL;
    (void)issuers, (void)n_issuers, (void)kinds, (void)n_kinds;
    if (!t)
        return -1;
    pthread_mutex_lock(&t->lock);
    *out = t->now->chain;
    *n_out = t->now->n;
    *key = t->now->key;
    pthread_mutex_unlock(&t->lock);
    return 0;
}

#ifdef CITYSPLAT_SCREEN /* libmicrohttpd before 1.0 */
static ssize_t tls_records(void *session, char *out, size_t room)
{
    unsigned char number[8];
    return gnutls_record_recv_seq(session, out, room, number);
}

ssize_t gnutls_record_recv(gnutls_session_t session, void *out, size_t room)
{
    struct request_screen *s = request_screen_at(gnutls_transport_get_int(session));
    ssize_t last = GNUTLS_E_AGAIN;
    if (!s || !s->tls || s->passes)
        return tls_records(session, out, room);
    size_t n =
        request_screen_read(s, tls_records, session, REQUEST_SCREEN_RECORDS, out, room, &last);
    return n ? (ssize_t)n : last;
}
#endif

bool tls_ask(int fd, const char *text, char *answer, size_t room)
{
    gnutls_certificate_credentials_t c = NULL;
    gnutls_session_t session = NULL;
    bool well = gnutls_certificate_allocate_credentials(&c) == GNUTLS_E_SUCCESS &&
                gnutls_init(&session, GNUTLS_CLIENT) == GNUTLS_E_SUCCESS &&
                gnutls_set_default_priority(session) == GNUTLS_E_SUCCESS &&
                gnutls_credentials_set(session, GNUTLS_CRD_CERTIFICATE, c) == GNUTLS_E_SUCCESS;
    if (well) {
        ssize_t got;
        gnutls_transport_set_int(session, fd); /* whose timeouts are those of this, too */
        well = gnutls_handshake(session) == GNUTLS_E_SUCCESS &&
               gnutls_record_send(session, text, strlen(text)) == (ssize_t)strlen(text);
        do
            got = well ? gnutls_record_recv(session, answer, room) : -1;
        while (got == GNUTLS_E_INTERRUPTED);
        well = got > 0;
    }
    if (session)
        gnutls_deinit(session);
    gnutls_certificate_free_credentials(c);
    return well;
}
