/* TLS on the first listener: certificate and key, which a reload replaces.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TLS_H
#define SERVER_TLS_H

#include <gnutls/abstract.h>
#include <gnutls/gnutls.h>

#include "core/base.h"

/* Protocols and ciphers: GnuTLS's SECURE128 without TLS 1.0 and 1.1. */
#define TLS_PRIORITIES "SECURE192:+SECURE128:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2"

struct tls;      /* any thread */
struct tls_pair; /* a certificate with its chain, and its key */

/* Reads both files (PEM). Call tls_close after the connections. ERR_ARG: one of the two is not
 * given, or other users may read the key. ERR_NOENT, ERR_IO. ERR_FORMAT: a file is invalid.
 * ERR_DATA: certificate and key do not belong together. ERR_MEM. */
enum err_code tls_open(const char *cert_path, const char *key_path, struct tls **out,
                       struct err *e) ERR_USE;
void tls_close(struct tls **t);
/* tls_read reads the files again. tls_use uses the result for new connections; open ones keep the
 * pair that they began with. tls_use and tls_discard free *pair. tls_read: ERR_ARG, ERR_NOENT,
 * ERR_IO, ERR_FORMAT, ERR_DATA, ERR_MEM as in tls_open. */
enum err_code tls_read(const struct tls *t, struct tls_pair **pair, struct err *e) ERR_USE;
void tls_use(struct tls *t, struct tls_pair **pair);
void tls_discard(struct tls_pair **pair);
/* Days until the certificate expires; negative: it has. */
double tls_days_left(struct tls *t);
/* Writes one line about the certificate: its name and its last day. */
void tls_about(struct tls *t, char *out, size_t room);

/* For libmicrohttpd: the certificate for a handshake. It is found by the screen of the connection's
 * descriptor. */
int tls_certificate(gnutls_session_t session, const gnutls_datum_t *issuers, int n_issuers,
                    const gnutls_pk_algorithm_t *kinds, int n_kinds, gnutls_pcert_st **out,
                    unsigned *n_out, gnutls_privkey_t *key);
/* Sends a request to a server of this program on a connected socket, accepts any certificate, and
 * reads at least the first bytes of the answer. Returns false if that failed. */
bool tls_ask(int fd, const char *text, char *answer, size_t room);

#endif
