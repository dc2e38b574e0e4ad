/* TLS on the first listener: certificate and key, which a reload replaces.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TLS_H
#define SERVER_TLS_H

#include <gnutls/abstract.h>
#include <gnutls/gnutls.h>

#include "core/base.h"

/* Protocols and ciphers: those of GnuTLS's own SECURE128, without TLS 1.0 and 1.1. */
#define TLS_PRIORITIES "SECURE192:+SECURE128:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2"

struct tls;      /* any thread */
struct tls_pair; /* a certificate, with those that lead to it, and its key */

/* Read both files (PEM). tls_close it after the connections. ERR_ARG: one of the two is not named,
 * or others may read the key. ERR_NOENT, ERR_IO; ERR_FORMAT: not what its name says; ERR_DATA: the
 * two do not fit; ERR_MEM. */
enum err_code tls_open(const char *cert_path, const char *key_path, struct tls **out,
                       struct err *e) ERR_USE;
void tls_close(struct tls **t);
/* Read the files again, and what was read, used from now on: connections that are there keep what
 * they began with. *pair is taken by tls_use and tls_discard. tls_read: errors as tls_open:
 * ERR_ARG, ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_DATA, ERR_MEM. */
enum err_code tls_read(const struct tls *t, struct tls_pair **pair, struct err *e) ERR_USE;
void tls_use(struct tls *t, struct tls_pair **pair);
void tls_discard(struct tls_pair **pair);
/* One line about the certificate: whose it is, and until when. */
void tls_about(struct tls *t, char *out, size_t room);

/* For libmicrohttpd: the certificate of a handshake, found by the screen of its descriptor. */
int tls_certificate(gnutls_session_t session, const gnutls_datum_t *issuers, int n_issuers,
                    const gnutls_pk_algorithm_t *kinds, int n_kinds, gnutls_pcert_st **out,
                    unsigned *n_out, gnutls_privkey_t *key);
/* Ask a server of this program on a connected socket, whatever its certificate, and read at least
 * the first bytes of its answer. False: it did not. */
bool tls_ask(int fd, const char *text, char *answer, size_t room);

#endif
